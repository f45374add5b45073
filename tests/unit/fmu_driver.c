/* Drives an FMU of FMI 3.0 that is linked to it, as a test under sanitizers: modes, errors, states, two instances. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "config.h"
#include "fmi3Functions.h"

#define CHECK(condition)                                                    \
    do {                                                                    \
        if (!(condition)) {                                                 \
            fprintf(stderr, "line %d: %s is false\n", __LINE__, #condition); \
            exit(1);                                                        \
        }                                                                   \
    } while (0)

static int told = 0;

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                        fmi3String message) {
    (void)environment;
    CHECK(strlen(message) > 0 && strlen(category) > 0 && status != fmi3OK);
    told++;
}

static fmi3Instance co_simulation(void) {
    fmi3Instance c = fmi3InstantiateCoSimulation("two", INSTANTIATION_TOKEN, NULL, fmi3False, fmi3True, fmi3False,
                                                 fmi3False, NULL, 0, NULL, log_message, NULL);
    CHECK(c);
    CHECK(fmi3EnterInitializationMode(c, fmi3True, 1e-10, 0.0, fmi3False, 0.0) == fmi3OK);
    CHECK(fmi3ExitInitializationMode(c) == fmi3OK);
    return c;
}

static double advance(fmi3Instance c, double from, double span) {
    fmi3Boolean event, terminate, early;
    double reached;
    CHECK(fmi3DoStep(c, from, span, fmi3True, &event, &terminate, &early, &reached) == fmi3OK);
    CHECK(!event && !terminate && !early);
    return reached;
}

static double first_state(fmi3Instance c) {
    const fmi3ValueReference state = 1;
    double value;
    CHECK(fmi3GetFloat64(c, &state, 1, &value, 1) == fmi3OK);
    return value;
}

static void model_exchange(void) {
    const fmi3ValueReference all[] = {0, 1, 1 + NX, 1 + 2 * NX, 1 + 2 * NX + NP}, wrong = 1 + 2 * NX + NP + NY;
    double x[NX], xdot[NX], values[5], seed[2] = {1.0, -0.5};
    fmi3Boolean flags[5];
    double next;
    size_t count;
    fmi3Instance c = fmi3InstantiateModelExchange("one", "another model", NULL, fmi3False, fmi3True, NULL, log_message);
    CHECK(!c && told == 1);
    c = fmi3InstantiateModelExchange("a name that is longer than what an instance keeps of it, which is one hundred and "
                                     "twenty-seven characters and then nothing more of it",
                                     INSTANTIATION_TOKEN, NULL, fmi3False, fmi3True, NULL, log_message);
    CHECK(c);
    CHECK(fmi3GetNumberOfContinuousStates(c, &count) == fmi3OK && count == NX);
    CHECK(fmi3EnterInitializationMode(c, fmi3False, 0.0, 1.0, fmi3True, 2.0) == fmi3OK);
    CHECK(fmi3ExitInitializationMode(c) == fmi3OK);
    CHECK(fmi3UpdateDiscreteStates(c, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], &next) == fmi3OK);
    CHECK(!flags[0] && !flags[1] && !flags[2] && !flags[3] && !flags[4]);
    CHECK(fmi3EnterContinuousTimeMode(c) == fmi3OK);
    CHECK(fmi3GetContinuousStates(c, x, NX) == fmi3OK);
    x[0] += 0.5;
    CHECK(fmi3SetTime(c, 1.5) == fmi3OK && fmi3SetContinuousStates(c, x, NX) == fmi3OK);
    CHECK(fmi3GetContinuousStateDerivatives(c, xdot, NX) == fmi3OK);
    CHECK(fmi3GetFloat64(c, all, 5, values, 5) == fmi3OK);
    CHECK(values[0] == 1.5 && values[1] == x[0] && values[2] == xdot[0]);
    CHECK(fmi3GetDirectionalDerivative(c, &all[2], 1, &all[1], 2, seed, 2, values, 1) == fmi3Error);
    CHECK(fmi3GetContinuousStateDerivatives(c, xdot, NX) == fmi3Error);
    CHECK(fmi3Reset(c) == fmi3OK);
    CHECK(fmi3GetFloat64(c, &wrong, 1, values, 1) == fmi3Error);
    CHECK(fmi3Reset(c) == fmi3OK);
    CHECK(fmi3SetTime(c, 0.0) == fmi3Error);
    fmi3FreeInstance(c);
    fmi3FreeInstance(NULL);
}

static void adjoint_is_the_transpose(void) {
    fmi3ValueReference unknowns[NX + NY], knowns[1 + NX + NP];
    double column[NX + NY], row[1 + NX + NP], seed[1 + NX + NP], weight[NX + NY], left = 0.0, right = 0.0;
    fmi3Instance c = co_simulation();
    int i;
    for (i = 0; i < NX; i++) unknowns[i] = 1 + NX + i;
    for (i = 0; i < NY; i++) unknowns[NX + i] = 1 + 2 * NX + NP + i;
    for (i = 0; i <= NX; i++) knowns[i] = i;
    for (i = 0; i < NP; i++) knowns[1 + NX + i] = 1 + 2 * NX + i;
    for (i = 0; i < 1 + NX + NP; i++) seed[i] = sin(1.0 + i);
    for (i = 0; i < NX + NY; i++) weight[i] = cos(2.0 * i);
    CHECK(fmi3GetDirectionalDerivative(c, unknowns, NX + NY, knowns, 1 + NX + NP, seed, 1 + NX + NP, column, NX + NY) ==
          fmi3OK);
    CHECK(fmi3GetAdjointDerivative(c, unknowns, NX + NY, knowns, 1 + NX + NP, weight, NX + NY, row, 1 + NX + NP) ==
          fmi3OK);
    for (i = 0; i < NX + NY; i++) left += weight[i] * column[i];
    for (i = 0; i < 1 + NX + NP; i++) right += row[i] * seed[i];
    CHECK(fabs(left - right) <= 1e-13 * (1.0 + fabs(left)));
    fmi3FreeInstance(c);
}

static void states(void) {
    fmi3Instance one = co_simulation(), two = co_simulation();
    fmi3FMUState kept = NULL, again = NULL;
    fmi3Byte *bytes;
    size_t size;
    double expected;
    CHECK(advance(one, 0.0, 1.0) == 1.0);
    CHECK(fmi3GetFMUState(one, &kept) == fmi3OK && fmi3GetFMUState(one, &kept) == fmi3OK);
    advance(two, 0.0, 0.25);
    advance(one, 1.0, 2.0);
    expected = first_state(one);
    CHECK(fmi3SerializedFMUStateSize(one, kept, &size) == fmi3OK);
    bytes = malloc(size);
    CHECK(fmi3SerializeFMUState(one, kept, bytes, size) == fmi3OK);
    CHECK(fmi3DeserializeFMUState(two, bytes, size, &again) == fmi3OK);
    CHECK(fmi3SetFMUState(two, again) == fmi3OK);
    CHECK(first_state(two) != expected);
    advance(two, 1.0, 2.0);
    CHECK(first_state(two) == expected);
    bytes[0] = 0;
    CHECK(fmi3DeserializeFMUState(two, bytes, size, &again) == fmi3Error);
    CHECK(fmi3FreeFMUState(two, &again) == fmi3OK && fmi3FreeFMUState(one, &kept) == fmi3OK && !kept);
    free(bytes);
    fmi3FreeInstance(one);
    fmi3FreeInstance(two);
}

int main(void) {
    model_exchange();
    adjoint_is_the_transpose();
    states();
    printf("%d messages\n", told);
    return 0;
}
