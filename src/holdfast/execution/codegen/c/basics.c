/* What expressions are made of, beside what libm has (as primitives.py of holdfast has it). */

static inline double hf_wrap(double x) {
    return x - 6.283185307179586 * ceil((x - 3.141592653589793) / 6.283185307179586);
}

static inline double hf_sgn(double x) { return x >= 0.0 ? 1.0 : (x < 0.0 ? -1.0 : x); }

static inline double hf_sign(double x) { return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : 0.0 * x); }

static inline double hf_least(double a, double b) { return a != a ? a : (a < b ? a : b); }

static inline double hf_greatest(double a, double b) { return a != a ? a : (a > b ? a : b); }

static inline double hf_select(double x, double a, double b) {
    return x >= 0.0 ? a : (x < 0.0 ? b : x);
}

static inline double hf_length(double x, double y) { return sqrt(x * x + y * y); }
