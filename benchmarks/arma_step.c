/* One recursive prediction-error step in C: the arithmetic of navfilter/kernels/arma.py, on the same state table. */
#include <math.h>
#include <stdint.h>

enum { HEAD, THETA, PHI, PSI, MORE, GAIN, TRIAL, SCRATCH, COV };
enum { AR, MA, EXOG, ELS, LAM, LAM_END, LAM_RATE, RADIUS_A, RADIUS_C, VAR, CAP, CLIP, SPREAD, ORIGIN, UNIT, POS, DUE,
       SETTLE, RUNNING, MISSED, CLIPPED, IDLE, HELD, REPEATED, SEEN, INNOVATION, LAST, CENTRE };

static int inside(const double *restrict trial, double *restrict w, int order, double radius)
{
    double inverse = 1.0 / radius, power = 1.0;
    for (int i = 0; i < order; i++) { power *= inverse; w[i] = trial[i] * power; }
    for (int top = order - 1; top > 0; top--) {
        double k = w[top];
        if (!(fabs(k) < 1.0)) return 0;
        double scale = 1.0 / (1.0 - k * k);
        for (int i = 0; i < (top + 1) / 2; i++) {
            int j = top - 1 - i;
            double front = w[i], back = w[j];
            w[i] = (front - k * back) * scale;
            w[j] = (back - k * front) * scale;
        }
    }
    return order == 0 || fabs(w[0]) < 1.0;
}

static double adapt(double *restrict s, int64_t width, double y, double e, int p, int q, int n)
{
    double *restrict theta = s + THETA * width, *restrict phi = s + PHI * width, *restrict psi = s + PSI * width;
    double *restrict gain = s + GAIN * width, *restrict trial = s + TRIAL * width, *restrict w = s + SCRATCH * width;
    double *restrict P = s + COV * width;
    for (int i = 0; i < n; i++) gain[i] = P[i] * psi[0];
    for (int j = 1; j < n; j++)
        for (int i = 0; i < n; i++) gain[i] += P[j * width + i] * psi[j];
    double spread = 0.0, trace = 0.0, lam = s[LAM];
    for (int i = 0; i < n; i++) { spread += psi[i] * gain[i]; trace += P[i * width + i]; }
    if (!(spread > 1e-6 * (1.0 - lam) && spread < 1e12)) { s[IDLE] += 1.0; return e; }
    double inverse = 1.0 / (lam + spread), step = e * inverse, residual = e;
    for (int tries = 0; tries < 5; tries++) {
        for (int i = 0; i < n; i++) trial[i] = theta[i] + step * gain[i];
        if (inside(trial, w, p, s[RADIUS_A]) && inside(trial + p, w, q, s[RADIUS_C])) {
            residual = y;
            for (int i = 0; i < n; i++) { theta[i] = trial[i]; residual -= phi[i] * theta[i]; }
            break;
        }
        s[HELD] += 1.0;
        step *= 0.5;
    }
    double grow = trace * (s[VAR] + 1e-12) < s[CAP] ? 1.0 / lam : 1.0;
    for (int j = 0; j < n; j++) {
        double weight = gain[j];
        for (int i = 0; i < n; i++) P[j * width + i] = (P[j * width + i] - (weight * gain[i]) * inverse) * grow;
    }
    return residual;
}

static void recall(double *restrict s, int64_t width, double y, double e, int p, int q)
{
    double *restrict theta = s + THETA * width, *restrict phi = s + PHI * width, *restrict psi = s + PSI * width;
    double *restrict more = s + MORE * width;
    double fy = -y, fe = e;
    if (s[ELS] == 0.0) {
        for (int k = q - 1; k >= p; k--) fy -= theta[p + k] * more[k - p];
        for (int k = (p < q ? p : q) - 1; k >= 0; k--) fy -= theta[p + k] * psi[k];
        for (int k = q - 1; k >= 0; k--) fe -= theta[p + k] * psi[p + k];
    }
    if (q > p) {
        for (int i = q - p - 1; i > 0; i--) more[i] = more[i - 1];
        more[0] = p > 0 ? psi[p - 1] : fy;
    }
    for (int i = p + q - 1; i > 0; i--) { phi[i] = phi[i - 1]; psi[i] = psi[i - 1]; }
    if (q > 0) { phi[p] = e; psi[p] = fe; }
    if (p > 0) { phi[0] = -y; psi[0] = fy; }
}

static int step(double *restrict s, int64_t width, double *restrict buf, double x)
{
    int p = (int)s[AR], q = (int)s[MA], n = p + q;
    int64_t pos = (int64_t)s[POS];
    s[POS] = (double)(pos + 1);
    s[SEEN] += 1.0;
    if (s[CENTRE] == 1.0 && fabs(x) < 1e75) { s[CENTRE] = 0.0; s[ORIGIN] = x; }
    double y = (x - s[ORIGIN]) * s[UNIT];
    int seen = fabs(y) < 1e75;
    if (seen) {
        if (x == s[LAST]) s[REPEATED] += 1.0;
        s[LAST] = x;
        buf[pos] = y;
    } else {
        s[MISSED] += 1.0;
        buf[pos] = NAN;
    }
    if (s[RUNNING] == 0.0) return pos + 1 >= s[DUE];
    double predicted = 0.0;
    for (int i = 0; i < n; i++) predicted += s[PHI * width + i] * s[THETA * width + i];
    if (!seen) {
        s[SETTLE] = p > q ? p : q;
        recall(s, width, predicted, 0.0, p, q);
        return pos + 1 >= s[DUE];
    }
    double e = y - predicted, posterior = e, lam = s[LAM];
    s[INNOVATION] = e;
    if (s[SETTLE] > 0.0) {
        s[SETTLE] -= 1.0;
    } else {
        if (n > 0) posterior = adapt(s, width, y, e, p, q, n);
        s[VAR] += (1.0 - lam) * (e * posterior - s[VAR]);
        s[LAM] = s[LAM_END] + (lam - s[LAM_END]) * s[LAM_RATE];
    }
    recall(s, width, y, posterior, p, q);
    return pos + 1 >= s[DUE];
}

void run(double *s, int64_t width, double *buf, const double *xs, int64_t count)
{
    for (int64_t i = 0; i < count; i++) step(s, width, buf, xs[i]);
}
