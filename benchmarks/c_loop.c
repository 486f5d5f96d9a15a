/* The exact two-input programs with one hard and one soft row, a plain loop over the arrays:
 * box, weight diag(q1, q2) and penalty as in the Python. The yardstick for the batch in NumPy.
 * Finite data in general position only: what the Python leaves to fractions is not caught here.
 */
#include <math.h>
#include <stddef.h>

typedef struct { double v, w; } Point;
typedef struct { double a, c, b; } Row;
typedef struct { double v_lo, v_hi, w_lo, w_hi; } Box;

static double clip(double x, double lo, double hi) { return x < lo ? lo : x > hi ? hi : x; }

static double excess(const Row *r, Point u) { return r->a * u.v + r->c * u.w - r->b; }

/* The part lo <= t <= hi of the line (x - c t, y + a t) in the box and in one row (or none). */
typedef struct { double x, y, lo, hi; } Chord;

static Chord chord(const Box *box, const Row *line, const Row *taken, Point u)
{
    Chord e;
    double k = excess(line, u) / (line->a * line->a + line->c * line->c), one, two;
    e.x = u.v - k * line->a;
    e.y = u.w - k * line->c;
    e.lo = -INFINITY;
    e.hi = INFINITY;
    if (line->c != 0.0) {
        one = (e.x - box->v_hi) / line->c;
        two = (e.x - box->v_lo) / line->c;
        e.lo = one < two ? one : two;
        e.hi = one < two ? two : one;
    } else if (e.x < box->v_lo || e.x > box->v_hi) {
        e.hi = -INFINITY;
    }
    if (line->a != 0.0) {
        one = (box->w_lo - e.y) / line->a;
        two = (box->w_hi - e.y) / line->a;
        if (one > two) { double swap = one; one = two; two = swap; }
        if (one > e.lo) e.lo = one;
        if (two < e.hi) e.hi = two;
    } else if (e.y < box->w_lo || e.y > box->w_hi) {
        e.hi = -INFINITY;
    }
    if (taken) {
        double rate = line->a * taken->c - line->c * taken->a;
        double t = (taken->b - taken->a * e.x - taken->c * e.y) / rate;
        if (rate > 0.0) { if (t < e.hi) e.hi = t; }
        else if (t > e.lo) e.lo = t;
    }
    return e;
}

static Point at(const Box *box, const Row *line, const Chord *e, double t)
{
    Point u = { clip(e->x - line->c * t, box->v_lo, box->v_hi),
                clip(e->y + line->a * t, box->w_lo, box->w_hi) };
    return u;
}

/* Move u to the line's point of least cost if it violates the row; 0 where there is none. */
static int project(const double *q, Point n, const Box *box, const Row *line, const Row *taken,
                   Point *u)
{
    if (excess(line, *u) <= 0.0) return 1;
    Chord e = chord(box, line, taken, *u);
    if (!(e.lo <= e.hi)) return 0;
    double g_v = -q[0] * line->c, g_w = q[1] * line->a;
    double t = (g_v * (n.v - e.x) + g_w * (n.w - e.y)) / (g_w * line->a - g_v * line->c);
    *u = at(box, line, &e, clip(t, e.lo, e.hi));
    return 1;
}

/* The corner of the box, cut by a row (or none), where another row is violated least. */
static Point lowest(const Box *box, const Row *row, const Row *taken)
{
    Point u = { row->a > 0.0 ? box->v_lo : box->v_hi, row->c > 0.0 ? box->w_lo : box->w_hi };
    if (taken && excess(taken, u) > 0.0) {
        Chord e = chord(box, taken, NULL, u);
        u = at(box, taken, &e, row->c * taken->a - row->a * taken->c > 0.0 ? e.lo : e.hi);
    }
    return u;
}

static double distance(const Row *row, Point u)
{
    return excess(row, u) / sqrt(row->a * row->a + row->c * row->c);
}

/* Lexicographic: out = v, omega, slack of the hard row, slack of the soft row. */
void solve_lexicographic(size_t count, const double *q, const double *nominal, const double *boxes,
                         const double *hard, const double *soft, double *out)
{
    for (size_t i = 0; i < count; i++) {
        Point n = { nominal[2 * i], nominal[2 * i + 1] };
        const Box *box = (const Box *)(boxes + 4 * i);
        const Row *h = (const Row *)(hard + 3 * i), *s = (const Row *)(soft + 3 * i);
        Point u = { clip(n.v, box->v_lo, box->v_hi), clip(n.w, box->w_lo, box->w_hi) };
        double slack_h = 0.0, slack_s = 0.0;
        if (!project(q, n, box, h, NULL, &u)) {
            u = lowest(box, h, NULL);
            slack_h = distance(h, u);
            slack_s = distance(s, u);
            if (slack_s < 0.0) slack_s = 0.0;
        } else if (!project(q, n, box, s, h, &u)) {
            u = lowest(box, s, h);
            slack_s = distance(s, u);
        }
        out[4 * i] = u.v;
        out[4 * i + 1] = u.w;
        out[4 * i + 2] = slack_h;
        out[4 * i + 3] = slack_s;
    }
}

/* One-shot with c delta^2: out = v, omega, delta, feasible (1 or 0). */
void solve_one_shot(size_t count, const double *q, double c, const double *nominal,
                    const double *boxes, const double *hard, const double *soft, double *out)
{
    for (size_t i = 0; i < count; i++) {
        Point n = { nominal[2 * i], nominal[2 * i + 1] };
        const Box *box = (const Box *)(boxes + 4 * i);
        const Row *h = (const Row *)(hard + 3 * i), *s = (const Row *)(soft + 3 * i);
        Point u = { clip(n.v, box->v_lo, box->v_hi), clip(n.w, box->w_lo, box->w_hi) };
        int feasible = project(q, n, box, h, NULL, &u);
        if (!feasible) {
            u = lowest(box, h, NULL);
        } else if (excess(s, u) > 0.0) {
            double r = excess(s, n), g_v = q[1] * s->a, g_w = q[0] * s->c;
            double k = c * r / (q[0] * q[1] + c * (s->a * g_v + s->c * g_w));
            u.v = n.v - k * g_v;
            u.w = n.w - k * g_w;
            if (u.v < box->v_lo || u.v > box->v_hi) {
                u.v = clip(u.v, box->v_lo, box->v_hi);
                u.w = n.w - c * s->c * (s->a * (u.v - n.v) + r) / (q[1] + c * s->c * s->c);
            }
            if (u.w < box->w_lo || u.w > box->w_hi) {
                u.w = clip(u.w, box->w_lo, box->w_hi);
                u.v = n.v - c * s->a * (s->c * (u.w - n.w) + r) / (q[0] + c * s->a * s->a);
                u.v = clip(u.v, box->v_lo, box->v_hi);
            }
            if (excess(h, u) > 0.0) {
                Chord e = chord(box, h, NULL, u);
                Point p = { e.x, e.y };
                double d_v = -h->c, d_w = h->a, slope = s->a * d_v + s->c * d_w;
                double t = (q[0] * d_v * (n.v - e.x) + q[1] * d_w * (n.w - e.y)
                            - c * slope * excess(s, p))
                           / (q[0] * d_v * d_v + q[1] * d_w * d_w + c * slope * slope);
                u = at(box, h, &e, clip(t, e.lo, e.hi));
            }
        }
        double delta = excess(s, u);
        out[4 * i] = u.v;
        out[4 * i + 1] = u.w;
        out[4 * i + 2] = delta > 0.0 ? delta : 0.0;
        out[4 * i + 3] = feasible;
    }
}
