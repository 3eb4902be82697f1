/* Memory for one tile of lanes, what goes in and what comes out of it. */
#ifndef WORK_H
#define WORK_H

#include "mass_matrix.h"
#include "motion.h"
#include "regressor.h"
#include "torque.h"

/* by_state: of joints, by q, then by qd, then by qdd. */
typedef struct {
    Robot robot;
    Motion *motion;
    Wrench *wrench;
    Inertia *inertia, *sum;
    Adjoint *adjoint;
    Columns *columns;
    Screw *screw;
    V *weight, *by_state;
} Work;

enum { TORQUE = 1, ADJOINT = 2, COLUMNS = 4, MASS = 8 };

/* Tiles whose regressors are written in one go: shorter pieces of rows cost more than the arithmetic. */
enum { TOGETHER = 8 };

/* Takes lanes for `count` objects of `size` from memory, where there is some, and counts them. */
static void *part(V *memory, size_t *used, int64_t count, size_t size) {
    size_t first = *used;
    *used += (size_t)count * (size / sizeof(V));
    return memory ? memory + first : NULL;
}

static size_t lay_out(Work *w, V *memory, int needs) {
    int64_t n = w->robot.bodies, dofs = w->robot.dofs;
    size_t used = 0;
    int64_t tiles = needs & COLUMNS ? TOGETHER : 1;
    w->motion = part(memory, &used, (n + 1) * tiles, sizeof(Motion));
    w->weight = part(memory, &used, needs & MASS ? dofs * dofs : n, sizeof(V));
    w->inertia = part(memory, &used, n, sizeof(Inertia));
    if (needs & TORQUE) w->wrench = part(memory, &used, n + 1, sizeof(Wrench));
    if (needs & (ADJOINT | MASS)) w->sum = part(memory, &used, n, sizeof(Inertia));
    if (needs & ADJOINT) {
        w->adjoint = part(memory, &used, n + 1, sizeof(Adjoint));
        w->by_state = part(memory, &used, dofs * 3, sizeof(V));
    }
    if (needs & COLUMNS) w->columns = part(memory, &used, n * tiles, sizeof(Columns));
    if (needs & MASS) w->screw = part(memory, &used, n, sizeof(Screw));
    return used;
}

static void clear_inertia(Work *w) { memset(w->sum, 0, sizeof(Inertia) * (size_t)w->robot.bodies); }
static void clear_states(Work *w) { memset(w->by_state, 0, sizeof(V) * 3 * (size_t)w->robot.dofs); }

/* Returns the memory to free, or NULL if there is none. */
static V *begin(Work *w, const int64_t *structure, const double *constants, int needs) {
    void *memory = NULL;
    *w = (Work){.robot = robot_of(structure, constants)};
    if (posix_memalign(&memory, sizeof(V), lay_out(w, NULL, needs) * sizeof(V))) return NULL;
    lay_out(w, memory, needs);
    if (w->sum) clear_inertia(w);
    return memory;
}

static void take_rates(Work *w, const double *qd, const double *qdd, Layout layout, int count) {
    for (int64_t b = 0; b < w->robot.bodies; b++) {
        int64_t at = w->robot.nodes[b].driver * layout.joint;
        double multiplier = w->robot.constants[b].multiplier;
        w->motion[b + 1].qd = load(qd + at, layout.sample, count) * multiplier;
        w->motion[b + 1].qdd = load(qdd + at, layout.sample, count) * multiplier;
    }
}

static void take_motion(Work *w, const double *q, const double *qd, const double *qdd, Layout layout, int count) {
    place(&w->robot, w->motion, q, layout, count);
    take_rates(w, qd, qdd, layout, count);
    move(&w->robot, w->motion);
}

/* One set of inertial parameters for all samples where `sample` is 0, otherwise one a lane. */
static void take_inertia(Work *w, const double *pi, int64_t parameter, int64_t sample, int count) {
    for (int64_t b = 0; b < w->robot.bodies; b++)
        w->inertia[b] = load_inertia(pi + 10 * b * parameter, parameter, sample, count);
}

/* Weights of bodies from those of the joints they follow; zero where no sample is. */
static void take_weights(Work *w, const double *weight, int64_t joint, int64_t sample, int count) {
    for (int64_t b = 0; b < w->robot.bodies; b++)
        w->weight[b] = masked(load(weight + w->robot.nodes[b].driver * joint, sample, count), count) *
                       w->robot.constants[b].multiplier;
}

/* Weight 1 for the torque of one joint. */
static void choose(Work *w, int64_t joint, int count) {
    for (int64_t b = 0; b < w->robot.bodies; b++)
        w->weight[b] = masked(splat(w->robot.nodes[b].driver == joint ? w->robot.constants[b].multiplier : 0), count);
}

static void add_states(Work *w) {
    int64_t n = w->robot.dofs;
    for (int64_t b = 0; b < w->robot.bodies; b++) {
        V *sum = w->by_state + w->robot.nodes[b].driver;
        double multiplier = w->robot.constants[b].multiplier;
        sum[0] += multiplier * w->adjoint[b + 1].q;
        sum[n] += multiplier * w->adjoint[b + 1].qd;
        sum[2 * n] += multiplier * w->adjoint[b + 1].qdd;
    }
}

static void store_all(double *out, Layout layout, int count, const V *values, int64_t n) {
    for (int64_t j = 0; j < n; j++) store(out + j * layout.joint, layout.sample, count, values[j]);
}

/* Sums over the lanes, or each lane's own with `sample` numbers between them. */
static void store_inertia(const Work *w, double *by_pi, int64_t sample, int count) {
    for (int64_t b = 0; b < w->robot.bodies; b++) {
        const Inertia *I = w->sum + b;
        const V v[10] = {I->m, I->mc.x, I->mc.y, I->mc.z, I->xx, I->xy, I->yy, I->xz, I->yz, I->zz};
        for (int k = 0; k < 10; k++, by_pi++) {
            if (sample) store(by_pi, sample, count, v[k]);
            else *by_pi = total(v[k]);
        }
    }
}

static void store_gravity(V3 by_base, double *by_gravity, int64_t sample, int count) {
    const V v[3] = {-by_base.x, -by_base.y, -by_base.z};
    for (int k = 0; k < 3; k++, by_gravity++) {
        if (sample) store(by_gravity, sample, count, v[k]);
        else *by_gravity = total(v[k]);
    }
}

#endif
