/* A function at many places, some of which go together: its operations on lists of numbers, one a place; see program.c. */

#include "kernel.h"

KERNEL(at_places)(const places *p)
{
    for (int64_t first = 0; first < p->count; first += p->together) {
        const int64_t last = first + p->together < p->count ? p->together : p->count - first;
        double *list = p->of->values;
        for (int64_t a = 0; a < p->arguments; a++)
            for (int64_t c = 0, size = p->argument_sizes[a]; c < size; c++, list += p->together)
                for (int64_t i = 0; i < p->together; i++)
                    list[i] = p->argument[a][(first + (i < last ? i : last - 1)) * size + c];
        NAMED(evaluate)(p->of, 0, p->of->count);
        const int64_t *from = p->of->results;
        for (int64_t r = 0; r < p->results; r++)
            for (int64_t c = 0, size = p->result_sizes[r]; c < size; c++, from++)
                for (int64_t i = 0; i < last; i++)
                    p->result[r][(first + i) * size + c] = p->of->values[*from + i];
    }
    return 0;
}
