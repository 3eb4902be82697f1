/* A link in the play of its joint: what `deviation` in backlash.py returns, where no derivative is asked for. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

/* By sample: load and friction but for the Coulomb part, of a link that moves as the motor; what the load changes by as the
   link deviates; the motor's speed; the first of a link at rest; the motor's direction. */
typedef struct {
    const double *driven, *inertia, *stiffness, *damping, *speed, *held, *direction;
    double coulomb, dt, half;
} Link;

/* A sample of a flight: the direction in which the link slides and the sample at which it began to, whether it began from
   rest and whether it rests now; where it is, and how fast. */
typedef struct {
    double way, rest, x, rate;
    int64_t begin;
    int stuck;
} Flying;

static double acceleration(const Link *l, int64_t k, double x, double rate, double way) {
    return -(l->driven[k] + l->stiffness[k] * x + l->damping[k] * rate + l->coulomb * way) / l->inertia[k];
}

/* Follows a flight from a sample on and returns the sample at which it is over, or that after the last; turns the side to that
   which it meets. */
static int64_t fly(const Link *l, int64_t start, int64_t samples, double *side, Flying *flight) {
    double way = copysign(1, l->speed[start]), rest = 0, rate = 0, x = -*side * l->half;
    double pull = acceleration(l, start, x, rate, way);
    int64_t k = start, begin = start;
    int stuck = 0;
    while (fabs(x) < l->half || k == start) {
        flight[k] = (Flying){way, rest, x, rate, begin, stuck};
        if (++k == samples) break;
        double torque = l->held[k] + l->stiffness[k] * x, before = rate;
        int holds = fabs(torque) <= l->coulomb;
        if (!stuck) {
            double following = acceleration(l, k, x + l->dt * rate, rate + l->dt * pull, way);
            rate += 0.5 * l->dt * (pull + following);
            pull = following;
        }
        int turns = l->coulomb > 0 && (rate + l->speed[k]) * way < 0;
        if (stuck || (turns && holds)) {
            stuck = holds, rate = -l->speed[k], rest = 1, begin = k;
            way = copysign(1, -torque);
            pull = acceleration(l, k, x, rate, way);
        } else if (turns) {
            rate += l->dt * l->coulomb * way / l->inertia[k];
            way = -way;
            pull = acceleration(l, k, x, rate, way);
        }
        x += 0.5 * l->dt * (before + rate);
    }
    *side = -copysign(1, x);
    return k;
}

/* Integrates a flight from what the integral before has found. */
static void feed_back(const Link *l, int64_t start, int64_t end, double side, Flying *flight, double *gained) {
    double before = 0, way = 0;
    for (int64_t k = start; k < end; k++) {
        Flying *f = flight + k;
        double now = acceleration(l, k, f->x, f->rate, f->way);
        gained[k] = k == start ? 0 : gained[k - 1] + 0.5 * l->dt * (before + now);
        before = now;
    }
    for (int64_t k = start; k < end; k++) {
        Flying *f = flight + k;
        f->rate = f->stuck ? -l->speed[k] : gained[k] - gained[f->begin] - f->rest * l->speed[f->begin];
        if (k > start) way += 0.5 * l->dt * (f[-1].rate + f->rate);
        f->x = fmax(-l->half, fmin(l->half, way - side * l->half));
    }
}

/* Friction of the link beyond that of one that moves as the motor. */
static double more_friction(const Link *l, int64_t k, const Flying *f) {
    double at_rest = fmax(-l->coulomb, fmin(l->coulomb, -(l->held[k] + l->stiffness[k] * f->x)));
    return (f->stuck ? at_rest : l->coulomb * f->way) - l->coulomb * l->direction[k];
}

/* x and then friction, (2, rows, samples), of signals (7, rows, samples) in the order of Link. */
int deviation(int64_t rows, int64_t samples, const double *signals, double coulomb, double dt, double play, int64_t feedbacks,
              double *x) {
    Flying *flight = malloc(sizeof(Flying) * (size_t)samples);
    double *gained = malloc(sizeof(double) * (size_t)samples);
    if (!flight || !gained) {
        free(flight);
        free(gained);
        return 1;
    }
    double *more = x + rows * samples;
    for (int64_t row = 0; row < rows; row++, x += samples, more += samples) {
        const double *at[7];
        for (int s = 0; s < 7; s++) at[s] = signals + (s * rows + row) * samples;
        const Link l = {at[0], at[1], at[2], at[3], at[4], at[5], at[6], coulomb, dt, play / 2};
        double side = copysign(1, l.driven[0] + coulomb * copysign(1, l.speed[0]));
        for (int64_t k = 0; k < samples;) {
            double pressed = side * (l.driven[k] + coulomb * copysign(1, l.speed[k])), from = side;
            if (!(pressed < l.half * l.stiffness[k])) {
                more[k] = 0;
                x[k++] = -side * l.half;
                continue;
            }
            int64_t start = k;
            k = fly(&l, start, samples, &side, flight);
            for (int64_t time = 0; time < feedbacks; time++) feed_back(&l, start, k, from, flight, gained);
            for (int64_t i = start; i < k; i++) {
                x[i] = flight[i].x;
                more[i] = more_friction(&l, i, flight + i);
            }
        }
    }
    free(flight);
    free(gained);
    return 0;
}
