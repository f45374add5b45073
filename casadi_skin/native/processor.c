/* Which of the compiled kernels the processor can run, and the sources that they were compiled from. */

#include "kernel.h"

#ifndef __AVX2__
KERNEL(sources)(void) { return SOURCES; }

KERNEL(has_avx2)(void)
{
#ifdef __x86_64__
    return __builtin_cpu_supports("avx2") != 0;
#else
    return 0;
#endif
}
#endif
