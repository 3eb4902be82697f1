/* Filters along rows of samples: see filters.py, whose functions these equal. */
#include <stdint.h>
#include <stdlib.h>

enum { LANES = 8, TOGETHER = 32 };

/* out (rows, outputs): weighted sums over `taps` samples of x (rows, samples) from each `stride`-th on. */
int thinned(int64_t rows, int64_t samples, int64_t taps, int64_t stride, int64_t outputs, const double *kernel, const double *x,
            double *out) {
    for (int64_t row = 0; row < rows; row++, x += samples, out += outputs) {
        for (int64_t k = 0; k < outputs; k++) {
            const double *at = x + k * stride;
            double sum = 0, lanes[LANES] = {0};
            int64_t t = 0;
            for (; t + LANES <= taps; t += LANES)
                for (int i = 0; i < LANES; i++) lanes[i] += kernel[t + i] * at[t + i];
            for (; t < taps; t++) sum += kernel[t] * at[t];
            for (int i = 0; i < LANES; i++) sum += lanes[i];
            out[k] = sum;
        }
    }
    return 0;
}

static double left_at(int64_t k, int64_t order, const double *predictor, const double *x) {
    double left = x[k];
    for (int64_t p = 1; p <= order && p <= k; p++) left -= predictor[p - 1] * x[k - p];
    return left;
}

/* out (rows, count): what of x (rows, samples) at samples `index` a predictor of those before leaves. */
int unpredicted(int64_t rows, int64_t samples, int64_t order, int64_t count, const double *predictor, const int64_t *index,
                const double *x, double *out) {
    double *left = malloc(sizeof(double) * (size_t)samples);
    if (!left) return 1;
    for (int64_t row = 0; row < rows; row++, x += samples, out += count) {
        int64_t k = 0;
        for (; k < order && k < samples; k++) left[k] = left_at(k, order, predictor, x);
        for (; k + TOGETHER <= samples; k += TOGETHER) {
            double sum[TOGETHER];
            for (int i = 0; i < TOGETHER; i++) sum[i] = x[k + i];
            for (int64_t p = 1; p <= order; p++)
                for (int i = 0; i < TOGETHER; i++) sum[i] -= predictor[p - 1] * x[k + i - p];
            for (int i = 0; i < TOGETHER; i++) left[k + i] = sum[i];
        }
        for (; k < samples; k++) left[k] = left_at(k, order, predictor, x);
        for (int64_t i = 0; i < count; i++) out[i] = left[index[i]];
    }
    free(left);
    return 0;
}
