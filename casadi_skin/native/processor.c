/* Which of the compiled kernels the processor can run, and the sources that they were compiled from. */

#include "kernel.h"

#ifndef __AVX2__
KERNEL(sources)(void) { return SOURCES; }

/* The numbers that go together in the fastest of the kernels that the processor can run. */
KERNEL(numbers_together)(void)
{
#ifdef __x86_64__
    if (__builtin_cpu_supports("avx512f"))
        return 8;
    if (__builtin_cpu_supports("avx2"))
        return 4;
#endif
    return REGISTER;
}
#endif
