/* What Python calls, through operators that document it. Every call
   - takes a robot as tables.py lays it out;
   - takes states (samples, dofs), or (dofs, samples) where `batch_last`;
   - takes pi (10 bodies,) and gravity (3,), or (samples, 10 bodies) and (samples, 3) where `each`, and gives derivatives by
     them as sums over the samples, or of each sample;
   - returns 0, or 1 if there is no memory. */
#include "log_cholesky.h"
#include "work.h"

#define ROBOT const int64_t *structure, const double *constants, int64_t samples
#define STATES const double *q, const double *qd, const double *qdd
#define TILES(samples) for (int64_t first = 0; first < (samples); first += LANES)
#define COUNT(samples) (int)((samples) - first < LANES ? (samples) - first : LANES)

static const double WEIGHTLESS[3] = {0, 0, 0};

/* tau, as the states. */
int inverse_dynamics(ROBOT, int64_t batch_last, int64_t each, STATES, const double *pi, const double *gravity, double *tau) {
    Work w;
    V *memory = begin(&w, structure, constants, TORQUE);
    if (!memory) return 1;
    int64_t n = w.robot.dofs, own = each ? 10 * w.robot.bodies : 0, down = each ? 3 : 0;
    Layout layout = layout_of(batch_last, n, samples);
    TILES(samples) {
        int count = COUNT(samples);
        int64_t at = first * layout.sample;
        if (each || !first) {
            place_base(w.motion, gravity + first * down, down, count);
            take_inertia(&w, pi + first * own, 1, own, count);
        }
        take_motion(&w, q + at, qd + at, qdd + at, layout, count);
        require(&w.robot, w.motion, w.inertia, w.wrench);
        memset(w.weight, 0, sizeof(V) * (size_t)n);
        for (int64_t b = 0; b < w.robot.bodies; b++)
            w.weight[w.robot.nodes[b].driver] += w.robot.constants[b].multiplier * torque(&w.robot, w.motion, w.wrench, b);
        store_all(tau + at, layout, count, w.weight, n);
    }
    free(memory);
    return 0;
}

/* Derivatives of sum weight tau. by_q is NULL where those by the states and gravity are not asked for, by_pi where that is
   not. */
int inverse_dynamics_adjoint(ROBOT, int64_t batch_last, int64_t each, STATES, const double *pi, const double *gravity,
                             const double *weight, double *by_q, double *by_qd, double *by_qdd, double *by_pi,
                             double *by_gravity) {
    Work w;
    V *memory = begin(&w, structure, constants, TORQUE | ADJOINT);
    if (!memory) return 1;
    int64_t n = w.robot.dofs, own = each ? 10 * w.robot.bodies : 0, down = each ? 3 : 0;
    Layout layout = layout_of(batch_last, n, samples);
    V3 by_base = zero3();
    TILES(samples) {
        int count = COUNT(samples);
        int64_t at = first * layout.sample;
        if (each || !first) {
            place_base(w.motion, gravity + first * down, down, count);
            take_inertia(&w, pi + first * own, 1, own, count);
        }
        take_motion(&w, q + at, qd + at, qdd + at, layout, count);
        take_weights(&w, weight + at, layout.joint, layout.sample, count);
        if (each) clear_inertia(&w);
        weigh(&w.robot, w.motion, w.weight, w.adjoint, by_pi ? w.sum : NULL);
        if (by_pi && each) store_inertia(&w, by_pi + first * own, own, count);
        if (!by_q) continue;
        require(&w.robot, w.motion, w.inertia, w.wrench);
        differentiate(&w.robot, w.motion, w.inertia, w.wrench, w.weight, w.adjoint);
        clear_states(&w);
        add_states(&w);
        store_all(by_q + at, layout, count, w.by_state, n);
        store_all(by_qd + at, layout, count, w.by_state + n, n);
        store_all(by_qdd + at, layout, count, w.by_state + 2 * n, n);
        by_base = add(by_base, w.adjoint[0].a);
        if (each) store_gravity(w.adjoint[0].a, by_gravity + first * down, down, count);
    }
    if (by_pi && !each) store_inertia(&w, by_pi, 0, 0);
    if (by_q && !each) store_gravity(by_base, by_gravity, 0, 0);
    free(memory);
    return 0;
}

/* Derivatives of each torque by q, qd and qdd: slopes (samples, 3, dofs, dofs). */
int torque_slopes(ROBOT, int64_t batch_last, STATES, const double *pi, const double *gravity, double *slopes) {
    Work w;
    V *memory = begin(&w, structure, constants, TORQUE | ADJOINT);
    if (!memory) return 1;
    int64_t n = w.robot.dofs;
    Layout layout = layout_of(batch_last, n, samples), row = {1, 3 * n * n};
    place_base(w.motion, gravity, 0, LANES);
    take_inertia(&w, pi, 1, 0, LANES);
    TILES(samples) {
        int count = COUNT(samples);
        int64_t at = first * layout.sample;
        take_motion(&w, q + at, qd + at, qdd + at, layout, count);
        require(&w.robot, w.motion, w.inertia, w.wrench);
        for (int64_t j = 0; j < n; j++) {
            choose(&w, j, count);
            weigh(&w.robot, w.motion, w.weight, w.adjoint, NULL);
            differentiate(&w.robot, w.motion, w.inertia, w.wrench, w.weight, w.adjoint);
            clear_states(&w);
            add_states(&w);
            for (int k = 0; k < 3; k++)
                store_all(slopes + first * row.sample + (k * n + j) * n, row, count, w.by_state + k * n, n);
        }
    }
    free(memory);
    return 0;
}

/* Y (dofs, 10 bodies, samples), zero before. */
int regressor(ROBOT, int64_t batch_last, int64_t each, STATES, const double *gravity, double *Y) {
    Work w;
    V *memory = begin(&w, structure, constants, COLUMNS);
    if (!memory) return 1;
    int64_t down = each ? 3 : 0, bodies = w.robot.bodies;
    Layout layout = layout_of(batch_last, w.robot.dofs, samples);
    for (int64_t start = 0; start < samples; start += TOGETHER * LANES) {
        Work tile = w;
        for (int64_t first = start; first < samples && first < start + TOGETHER * LANES; first += LANES) {
            int count = COUNT(samples);
            int64_t at = first * layout.sample;
            place_base(tile.motion, gravity + first * down, down, count);
            take_motion(&tile, q + at, qd + at, qdd + at, layout, count);
            for (int64_t b = 0; b < bodies; b++) columns_of(tile.motion + b + 1, tile.columns + b);
            tile.motion += bodies + 1, tile.columns += bodies;
        }
        int64_t left = samples - start < TOGETHER * LANES ? samples - start : TOGETHER * LANES;
        fill(&w.robot, w.motion, w.columns, Y + start, samples, left);
    }
    free(memory);
    return 0;
}

/* Derivatives of sum weight Y, weight as Y: row by row that of a torque whose inertial parameters are the weights. */
int regressor_adjoint(ROBOT, int64_t batch_last, int64_t each, STATES, const double *gravity, const double *weight,
                      double *by_q, double *by_qd, double *by_qdd, double *by_gravity) {
    Work w;
    V *memory = begin(&w, structure, constants, TORQUE | ADJOINT);
    if (!memory) return 1;
    int64_t n = w.robot.dofs, down = each ? 3 : 0;
    Layout layout = layout_of(batch_last, n, samples);
    V3 by_base = zero3();
    TILES(samples) {
        int count = COUNT(samples);
        int64_t at = first * layout.sample;
        if (each || !first) place_base(w.motion, gravity + first * down, down, count);
        if (each) by_base = zero3();
        take_motion(&w, q + at, qd + at, qdd + at, layout, count);
        clear_states(&w);
        for (int64_t j = 0; j < n; j++) {
            take_inertia(&w, weight + j * 10 * w.robot.bodies * samples + first, samples, 1, count);
            choose(&w, j, count);
            require(&w.robot, w.motion, w.inertia, w.wrench);
            weigh(&w.robot, w.motion, w.weight, w.adjoint, NULL);
            differentiate(&w.robot, w.motion, w.inertia, w.wrench, w.weight, w.adjoint);
            add_states(&w);
            by_base = add(by_base, w.adjoint[0].a);
        }
        store_all(by_q + at, layout, count, w.by_state, n);
        store_all(by_qd + at, layout, count, w.by_state + n, n);
        store_all(by_qdd + at, layout, count, w.by_state + 2 * n, n);
        if (each) store_gravity(by_base, by_gravity + first * down, down, count);
    }
    if (!each) store_gravity(by_base, by_gravity, 0, 0);
    free(memory);
    return 0;
}

/* M (samples, dofs, dofs). */
int mass_matrix(ROBOT, int64_t batch_last, int64_t each, const double *q, const double *pi, double *M) {
    Work w;
    V *memory = begin(&w, structure, constants, MASS);
    if (!memory) return 1;
    int64_t n = w.robot.dofs, own = each ? 10 * w.robot.bodies : 0;
    Layout layout = layout_of(batch_last, n, samples);
    place_base(w.motion, WEIGHTLESS, 0, LANES);
    TILES(samples) {
        int count = COUNT(samples);
        if (each || !first) take_inertia(&w, pi + first * own, 1, own, count);
        place(&w.robot, w.motion, q + first * layout.sample, layout, count);
        composite_mass(&w.robot, w.motion, w.inertia, w.sum, w.screw, w.weight);
        store_all(M + first * n * n, (Layout){1, n * n}, count, w.weight, n * n);
    }
    free(memory);
    return 0;
}

/* Derivatives of sum weight M, weight as M: column by column that of the torque of a unit acceleration from rest. */
int mass_matrix_adjoint(ROBOT, int64_t batch_last, int64_t each, const double *q, const double *pi, const double *weight,
                        double *by_q, double *by_pi) {
    Work w;
    V *memory = begin(&w, structure, constants, TORQUE | ADJOINT);
    if (!memory) return 1;
    int64_t n = w.robot.dofs, own = each ? 10 * w.robot.bodies : 0;
    Layout layout = layout_of(batch_last, n, samples);
    place_base(w.motion, WEIGHTLESS, 0, LANES);
    TILES(samples) {
        int count = COUNT(samples);
        if (each || !first) take_inertia(&w, pi + first * own, 1, own, count);
        place(&w.robot, w.motion, q + first * layout.sample, layout, count);
        clear_states(&w);
        if (each) clear_inertia(&w);
        for (int64_t k = 0; k < n; k++) {
            for (int64_t b = 0; b < w.robot.bodies; b++) {
                w.motion[b + 1].qd = splat(0);
                w.motion[b + 1].qdd = splat(w.robot.nodes[b].driver == k ? w.robot.constants[b].multiplier : 0);
            }
            move(&w.robot, w.motion);
            take_weights(&w, weight + first * n * n + k, n, n * n, count);
            require(&w.robot, w.motion, w.inertia, w.wrench);
            weigh(&w.robot, w.motion, w.weight, w.adjoint, w.sum);
            differentiate(&w.robot, w.motion, w.inertia, w.wrench, w.weight, w.adjoint);
            add_states(&w);
        }
        store_all(by_q + first * layout.sample, layout, count, w.by_state, n);
        if (each) store_inertia(&w, by_pi + first * own, own, count);
    }
    if (!each) store_inertia(&w, by_pi, 0, 0);
    free(memory);
    return 0;
}

/* pi (bodies, 10) of theta (bodies, 10). */
int log_cholesky(int64_t bodies, const double *theta, double *pi) {
    for (int64_t b = 0; b < bodies; b++) {
        Factor factor = factor_of(theta + 10 * b);
        inertia_of(&factor, pi + 10 * b);
    }
    return 0;
}

/* Derivatives of sum weight pi. */
int log_cholesky_adjoint(int64_t bodies, const double *theta, const double *weight, double *by_theta) {
    for (int64_t b = 0; b < bodies; b++) {
        Factor factor = factor_of(theta + 10 * b);
        differentiate_inertia(&factor, weight + 10 * b, by_theta + 10 * b);
    }
    return 0;
}

/* tau, as the states, of bodies by theta (bodies, 10). */
int physical_torque(ROBOT, int64_t batch_last, STATES, const double *theta, const double *gravity, double *tau) {
    int64_t bodies = structure[0];
    double *pi = malloc(sizeof(double) * 10 * (size_t)bodies);
    if (!pi) return 1;
    log_cholesky(bodies, theta, pi);
    int failed = inverse_dynamics(structure, constants, samples, batch_last, 0, q, qd, qdd, pi, gravity, tau);
    free(pi);
    return failed;
}
