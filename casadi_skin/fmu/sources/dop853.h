/* The solver of Co-Simulation: the explicit Runge-Kutta method of order 8 of Dormand and Prince with the error estimates
   of orders 5 and 3 and the control of the step of E. Hairer, S. P. Norsett and G. Wanner, Solving Ordinary Differential
   Equations I, 2nd ed. (1993), Secs. II.4 and II.5 and the appendix (DOP853). The last step ends where the communication
   step does; the model has no events. */
#ifndef DOP853_H
#define DOP853_H

#include "instance.h"

enum { STAGES = SOLVER_STAGES, MAX_STEPS = 10000000 };

static const double NODES[STAGES] = {
    0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333, 0.25,
    0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0};
/* Row i, of i numbers, is that of stage i: it begins at i (i - 1)/2. */
static const double STAGE_WEIGHTS[66] = {
    0.05260015195876773, 0.0197250569845379, 0.0591751709536137, 0.02958758547680685, 0, 0.08876275643042054,
    0.2413651341592667, 0, -0.8845494793282861, 0.924834003261792, 0.037037037037037035, 0, 0, 0.17082860872947386,
    0.12546768756682242, 0.037109375, 0, 0, 0.17025221101954405, 0.06021653898045596, -0.017578125,
    0.03709200011850479, 0, 0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402, 0.008273789163814023,
    0.6241109587160757, 0, 0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894,
    -43.48988418106996, 0.47766253643826434, 0, 0, -2.4881146199716677, -0.590290826836843, 21.230051448181193,
    15.279233632882423, -33.28821096898486, -0.020331201708508627, -0.9371424300859873, 0, 0, 5.186372428844064,
    1.0914373489967295, -8.149787010746927, -18.52006565999696, 22.739487099350505, 2.4936055526796523,
    -3.0467644718982196, 2.273310147516538, 0, 0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
    27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636};
static const double WEIGHTS[STAGES] = {
    0.054293734116568765, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, 0.3111643669578199,
    -0.1521609496625161, 0.20136540080403034, 0.04471061572777259};
static const double ERROR_5[STAGES] = {
    0.01312004499419488, 0, 0, 0, 0, -1.2251564463762044, -0.4957589496572502, 1.6643771824549864,
    -0.35032884874997366, 0.3341791187130175, 0.08192320648511571, -0.022355307863886294};
static const double ERROR_3[STAGES] = {
    -0.18980075407240762, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, -0.4226823213237919,
    -0.1521609496625161, 0.20136540080403034, 0.02265179219836082};

/* STAGES - 1 more derivatives of a step of size h from the first, stage[0]; the end goes to `trial`. Nonzero where one of
   them is not finite. */
static int stages(Instance *c, double h) {
    const double *weight = STAGE_WEIGHTS;
    int i, j, n;
    for (i = 1; i < STAGES; i++, weight += i - 1) {
        for (n = 0; n < NX; n++) {
            double sum = 0.0;
            for (j = 0; j < i; j++) sum += weight[j] * c->stage[j][n];
            c->trial[n] = c->now.x[n] + h * sum;
        }
        if (derivatives_at(c, c->now.time + NODES[i] * h, c->trial, c->stage[i])) return 1;
    }
    for (n = 0; n < NX; n++) {
        double sum = 0.0;
        for (j = 0; j < STAGES; j++) sum += WEIGHTS[j] * c->stage[j][n];
        c->trial[n] = c->now.x[n] + h * sum;
    }
    return !all_finite(c->trial, NX);
}

/* Estimated error of the step in units of the tolerance; the scale of a state is at least its nominal value. */
static double error_of(const Instance *c, double h) {
    double five = 0.0, three = 0.0, below;
    int j, n;
    for (n = 0; n < NX; n++) {
        const double size = fmax(NOMINALS[n], fmax(fabs(c->now.x[n]), fabs(c->trial[n])));
        double e5 = 0.0, e3 = 0.0;
        for (j = 0; j < STAGES; j++) {
            e5 += ERROR_5[j] * c->stage[j][n];
            e3 += ERROR_3[j] * c->stage[j][n];
        }
        e5 /= c->now.tolerance * size;
        e3 /= c->now.tolerance * size;
        five += e5 * e5;
        three += e3 * e3;
    }
    below = five + 0.01 * three;
    return below > 0.0 ? h * five / sqrt(below * NX) : 0.0;
}

/* A first step that changes no state by more than a hundredth of its size. */
static double first_step(const Instance *c, double span) {
    double h = span;
    int n;
    for (n = 0; n < NX; n++) {
        const double size = fmax(NOMINALS[n], fabs(c->now.x[n]));
        if (fabs(c->stage[0][n]) * h > 0.01 * size) h = 0.01 * size / fabs(c->stage[0][n]);
    }
    return h;
}

/* Follow the equations from the time that the instance has to the time `end`. Where that fails the instance is as before
   and DISCARD is returned. */
static int integrate(Instance *c, const char *function, double end) {
    const Values before = c->now;
    int count;
    for (count = 0; count < MAX_STEPS; count++) {
        double span = end - c->now.time, h;
        if (derivatives_at(c, c->now.time, c->now.x, c->stage[0])) break;
        if (c->now.step <= 0.0) c->now.step = first_step(c, span);
        h = c->now.step;
        for (;;) {
            double error, factor;
            const int last = h >= span * (1.0 - 1e-12);
            if (last) h = span;
            else if (h > 0.5 * span) h = 0.5 * span; /* two steps alike instead of one and a small rest */
            if (c->now.time + 0.01 * h == c->now.time || !isfinite(h)) goto failed; /* no digits are left */
            if (stages(c, h)) {
                h *= 0.2;
                continue;
            }
            error = error_of(c, h);
            factor = error > 0.0 ? 0.9 * pow(error, -1.0 / 8.0) : 6.0;
            factor = fmin(6.0, fmax(1.0 / 3.0, factor));
            if (error > 1.0) {
                h *= fmin(factor, 0.9);
                c->now.step = h;
                continue;
            }
            memcpy(c->now.x, c->trial, NX * sizeof(double));
            c->now.time = last ? end : c->now.time + h;
            if (h * factor > c->now.step || h >= c->now.step) c->now.step = h * factor; /* a cut step says less */
            changed(c);
            if (last) return OK;
            break;
        }
    }
failed:
    {
        const double reached = c->now.time;
        c->now = before;
        changed(c);
        return say(c, DISCARD, "%s: the solution cannot be followed beyond time %.17g", function, reached);
    }
}

/* From one communication point to the next. */
static int communication_step(Instance *c, const char *function, double from, double span) {
    if (allowed(c, function, STEP) != OK) return ERROR;
    if (!(span > 0.0) || !isfinite(from + span))
        return say(c, ERROR, "%s: communication step %g; accepted: a finite number > 0", function, span);
    if (!(fabs(from - c->now.time) <= 1e-9 * fmax(span, fabs(from))))
        return say(c, ERROR, "%s: from time %.17g, while the model is at %.17g", function, from, c->now.time);
    return integrate(c, function, from + span);
}

#endif
