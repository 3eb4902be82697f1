/* Where the bodies are and how they move, in the base's axes: the equations of kinematics.py, one tile of lanes at a time.
   Body b stands at b + 1; the base, which never moves, at 0. */
#ifndef MOTION_H
#define MOTION_H

#include <stdlib.h>
#include <string.h>

#include "lanes.h"

/* As tables.py lays it out. */
typedef struct {
    double rotation[3][3][3]; /* A, B, C of E(q) = A + B sin q + C cos q, by rows */
    double translation[3], axis[3];
    double multiplier, offset; /* q_body = multiplier q[driver] + offset */
} Constants;

typedef struct { int64_t parent, end, driver, prismatic; } Node;

typedef struct {
    int64_t bodies, dofs;
    const Node *nodes;
    const Constants *constants;
} Robot;

INLINE Robot robot_of(const int64_t *structure, const double *constants) {
    return (Robot){structure[0], structure[1], (const Node *)(structure + 2), (const Constants *)constants};
}

/* A tensor of `n` values a sample: of joint j and sample k, x[j * joint + k * sample]. */
typedef struct { int64_t joint, sample; } Layout;

INLINE Layout layout_of(int64_t batch_last, int64_t n, int64_t samples) {
    return batch_last ? (Layout){samples, 1} : (Layout){1, n};
}

/* R by columns; z the joint's axis, p the origin, r the origin seen from the parent's; a includes -g. */
typedef struct {
    V3 R[3], z, p, r, omega, alpha, a;
    V qd, qdd;
} Motion;

/* One gravity for all samples where `sample` is 0, otherwise one a lane. */
static void place_base(Motion *motion, const double *gravity, int64_t sample, int count) {
    memset(motion, 0, sizeof *motion);
    motion->R[0].x = motion->R[1].y = motion->R[2].z = splat(1);
    motion->a = (V3){-load(gravity, sample, count), -load(gravity + 1, sample, count), -load(gravity + 2, sample, count)};
}

/* R = R_p E(q), r = R_p t [+ z q], p = p_p + r. */
static void place(const Robot *robot, Motion *motion, const double *q, Layout layout, int count) {
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Node *node = robot->nodes + b;
        const Constants *c = robot->constants + b;
        const Motion *parent = motion + node->parent + 1;
        Motion *body = motion + b + 1;
        V angle = load(q + node->driver * layout.joint, layout.sample, count) * c->multiplier + c->offset;
        V sine = splat(0), cosine = splat(0);
        if (!node->prismatic) sine_cosine(angle, &sine, &cosine);
        for (int k = 0; k < 3; k++) {
            V e[3];
            for (int i = 0; i < 3; i++)
                e[i] = c->rotation[0][i][k] + c->rotation[1][i][k] * sine + c->rotation[2][i][k] * cosine;
            body->R[k] = turned(parent->R, (V3){e[0], e[1], e[2]});
        }
        body->z = turned(body->R, splat3(c->axis[0], c->axis[1], c->axis[2]));
        body->r = turned(parent->R, splat3(c->translation[0], c->translation[1], c->translation[2]));
        if (node->prismatic) body->r = add(body->r, scale(angle, body->z));
        body->p = add(parent->p, body->r);
    }
}

/* omega = omega_p + z qd, alpha = alpha_p + z qdd + omega_p x z qd, a = a_p + alpha_p x r + omega_p x (omega_p x r);
   a slide moves, instead of turning: a += 2 omega_p x z qd + z qdd. Takes the body's own qd and qdd. */
static void move(const Robot *robot, Motion *motion) {
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Node *node = robot->nodes + b;
        const Motion *parent = motion + node->parent + 1;
        Motion *body = motion + b + 1;
        V3 turn = scale(body->qd, cross(parent->omega, body->z)), push = scale(body->qdd, body->z);
        body->omega = parent->omega, body->alpha = parent->alpha;
        body->a = add(parent->a, add(cross(parent->alpha, body->r), cross(parent->omega, cross(parent->omega, body->r))));
        if (node->prismatic) {
            body->a = add(body->a, add(add(turn, turn), push));
        } else {
            body->omega = add(body->omega, scale(body->qd, body->z));
            body->alpha = add(body->alpha, add(push, turn));
        }
    }
}

#endif
