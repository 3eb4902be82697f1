/* Inertial parameters of log-Cholesky coordinates theta = [alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3]: with
       W = [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3]],
   m = e^(2 alpha), mc = m t, and the second moment S = m W W' makes the inertia tr(S) 1 - S.
   Source: Rucker, Wensing, RA-L 2022, eq. (8) to (11). */
#ifndef LOG_CHOLESKY_H
#define LOG_CHOLESKY_H

#include <math.h>

typedef struct { double m, W[3][4]; } Factor;

static Factor factor_of(const double *theta) {
    return (Factor){exp(2 * theta[0]),
                    {{exp(theta[1]), theta[4], theta[6], theta[7]},
                     {0, exp(theta[2]), theta[5], theta[8]},
                     {0, 0, exp(theta[3]), theta[9]}}};
}

static void inertia_of(const Factor *f, double *pi) {
    double S[3][3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            S[i][j] = 0;
            for (int k = 0; k < 4; k++) S[i][j] += f->m * f->W[i][k] * f->W[j][k];
        }
    const double values[10] = {f->m, f->m * f->W[0][3], f->m * f->W[1][3], f->m * f->W[2][3], S[1][1] + S[2][2],
                               -S[0][1], S[0][0] + S[2][2], -S[0][2], -S[1][2], S[0][0] + S[1][1]};
    for (int k = 0; k < 10; k++) pi[k] = values[k];
}

/* Derivatives of sum weight pi: with sum weight I = sum G S, that by W is 2 m G W; all of pi grows with m. */
static void differentiate_inertia(const Factor *f, const double *weight, double *by_theta) {
    const double *w = weight;
    const double G[3][3] = {{w[6] + w[9], -w[5] / 2, -w[7] / 2},
                            {-w[5] / 2, w[4] + w[9], -w[8] / 2},
                            {-w[7] / 2, -w[8] / 2, w[4] + w[6]}};
    double by_W[3][4], pi[10], by_alpha = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 4; k++) {
            by_W[i][k] = k == 3 ? f->m * w[1 + i] : 0;
            for (int j = 0; j < 3; j++) by_W[i][k] += 2 * f->m * G[i][j] * f->W[j][k];
        }
    inertia_of(f, pi);
    for (int k = 0; k < 10; k++) by_alpha += 2 * pi[k] * w[k];
    const double values[10] = {by_alpha, by_W[0][0] * f->W[0][0], by_W[1][1] * f->W[1][1], by_W[2][2] * f->W[2][2],
                               by_W[0][1], by_W[1][2], by_W[0][2], by_W[0][3], by_W[1][3], by_W[2][3]};
    for (int k = 0; k < 10; k++) by_theta[k] = values[k];
}

#endif
