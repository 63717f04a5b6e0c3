/* The navigation update of nav/strapdown/kernels.py in C, statement by statement: what the compiled kernel is
   measured against. State, samples and control vector are laid out as there. */

#include <math.h>

#define EARTH_RATE 7.292115e-5
#define A 6378137.0
#define F (1.0 / 298.257223563)
#define B (A * (1.0 - F))
#define E2 (F * (2.0 - F))
#define GM 3.986004418e14
#define G_EQUATOR 9.7803253359
#define SOMIGLIANA 0.00193185265241
#define M_RATIO (EARTH_RATE * EARTH_RATE * A * A * B / GM)
#define DEFLECTION 8.08e-9

typedef struct { double w, x, y, z; } quat;

/* Yan Gongmin 2008, Table 7-1, by number of samples and separation */
static const double CONING[7][5] = {
    {0}, {0},
    {2.0 / 3.0},
    {27.0 / 20.0, 9.0 / 20.0},
    {214.0 / 105.0, 92.0 / 105.0, 54.0 / 105.0},
    {1375.0 / 504.0, 650.0 / 504.0, 525.0 / 504.0, 250.0 / 504.0},
    {15797.0 / 4620.0, 3917.0 / 2310.0, 608.0 / 385.0, 2279.0 / 2310.0, 463.0 / 924.0},
};

static void radii(double s, double *r_m, double *r_n) {
    double w2 = 1.0 - E2 * s * s, w = sqrt(w2);
    *r_m = A * (1.0 - E2) / (w2 * w);
    *r_n = A / w;
}

static double normal_gravity(double s, double h) {
    double s2 = s * s;
    double surface = G_EQUATOR * (1.0 + SOMIGLIANA * s2) / sqrt(1.0 - E2 * s2);
    double x = h / A;
    return surface * (1.0 - 2.0 * (1.0 + F + M_RATIO - 2.0 * F * s2) * x + 3.0 * x * x);
}

static double gravity_north(double s, double c, double h) { return -2.0 * DEFLECTION * h * s * c; }

static void curvature(double x, double y, double z, double h, double *kxx, double *kxy, double *kyy) {
    double r_m, r_n;
    radii(z, &r_m, &r_n);
    double base = 1.0 / (r_n + h);
    double w2 = 1.0 - E2 * z * z;
    double extra = A * E2 / (w2 * sqrt(w2)) / ((r_m + h) * (r_n + h));
    *kxx = base + extra * x * x;
    *kxy = extra * x * y;
    *kyy = base + extra * y * y;
}

static quat multiply(quat a, quat b) {
    quat r = {
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    };
    return r;
}

static quat exponential(double x, double y, double z) {
    double a2 = 0.25 * (x * x + y * y + z * z), s, c;
    if (a2 < 1e-4) {
        s = 0.5 * (1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0)));
        c = 1.0 - 0.5 * a2 * (1.0 - a2 / 12.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0)));
    } else {
        double a = sqrt(a2);
        s = 0.5 * sin(a) / a;
        c = cos(a);
    }
    quat q = {c, s * x, s * y, s * z};
    return q;
}

typedef struct { double x, y, z; } vec;

static vec sub_scaled(const double *a, const double *b, double m) {
    vec r = {(a[0] - b[0]) * m, (a[1] - b[1]) * m, (a[2] - b[2]) * m};
    return r;
}

static vec bend(const double *a, int e, int low, int high, double m) {
    vec r = {(a[0] + a[e] - a[low] - a[high]) * m, (a[1] + a[e + 1] - a[low + 1] - a[high + 1]) * m,
             (a[2] + a[e + 2] - a[low + 2] - a[high + 2]) * m};
    return r;
}

static vec cross(vec a, vec b) {
    vec r = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return r;
}

static vec add(vec a, vec b) {
    vec r = {a.x + b.x, a.y + b.y, a.z + b.z};
    return r;
}

static vec third_order(const double *d, int n, vec s, vec v) {
    static const double BEND[7] = {0, 0, 0, 2.0, 4.0, 8.0, 12.0};
    double m = (double)(n * n) / (n - 1), r = n * n * n / BEND[n];
    int e = 3 * (n - 1), low = 3 * ((n - 1) / 2), high = 3 * (n / 2);
    const double *o = d + 3 * n;
    vec a = sub_scaled(d + e, d, m), b = bend(d, e, low, high, r);
    vec u = sub_scaled(o + e, o, m), w = bend(o, e, low, high, r);
    vec l = add(cross(cross(s, a), u), cross(add(cross(s, u), cross(v, a)), a));
    vec k = add(cross(s, add(cross(s, w), cross(v, b))), cross(v, cross(s, b)));
    vec g = {l.x / 240.0 + k.x / 360.0, l.y / 240.0 + k.y / 360.0, l.z / 240.0 + k.z / 360.0};
    return g;
}

static void increments(const double *d, int n, double *inc) {
    int e = 3 * (n - 1), f = 6 * n - 3;
    double bx = d[e], by = d[e + 1], bz = d[e + 2], wx = d[f], wy = d[f + 1], wz = d[f + 2];
    double sx = 0.0, sy = 0.0, sz = 0.0, vx = 0.0, vy = 0.0, vz = 0.0;
    double cx = 0.0, cy = 0.0, cz = 0.0, gx = 0.0, gy = 0.0, gz = 0.0;
    for (int i = 0; i < n - 1; i++) {
        double k = CONING[n][n - 2 - i];
        const double *a = d + 3 * i, *u = d + 3 * (n + i);
        sx = sx + a[0], sy = sy + a[1], sz = sz + a[2];
        vx = vx + u[0], vy = vy + u[1], vz = vz + u[2];
        cx += k * (a[1] * bz - a[2] * by);
        cy += k * (a[2] * bx - a[0] * bz);
        cz += k * (a[0] * by - a[1] * bx);
        gx += k * ((a[1] * wz - a[2] * wy) + (u[1] * bz - u[2] * by));
        gy += k * ((a[2] * wx - a[0] * wz) + (u[2] * bx - u[0] * bz));
        gz += k * ((a[0] * wy - a[1] * wx) + (u[0] * by - u[1] * bx));
    }
    double px = sx + bx + cx, py = sy + by + cy, pz = sz + bz + cz, first, second;
    vx = vx + wx + gx, vy = vy + wy + gy, vz = vz + wz + gz;
    if (n > 2) {
        vec s = {sx + bx, sy + by, sz + bz}, v = {vx - gx, vy - gy, vz - gz};
        vec g = third_order(d, n, s, v);
        vx = vx + g.x, vy = vy + g.y, vz = vz + g.z;
    }
    double a2 = px * px + py * py + pz * pz;
    if (a2 < 0.01) {
        first = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0));
        second = (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0))) / 6.0;
    } else {
        double a = sqrt(a2);
        first = (1.0 - cos(a)) / a2;
        second = (1.0 - sin(a) / a) / a2;
    }
    double tx = py * vz - pz * vy, ty = pz * vx - px * vz, tz = px * vy - py * vx;
    inc[0] = px, inc[1] = py, inc[2] = pz;
    inc[3] = vx + first * tx + second * (py * tz - pz * ty);
    inc[4] = vy + first * ty + second * (pz * tx - px * tz);
    inc[5] = vz + first * tz + second * (px * ty - py * tx);
}

static void rotate_columns(double *c, double rx, double ry, double rz) {
    quat q = exponential(rx, ry, rz);
    double w = q.w, i = q.x, j = q.y, k = q.z;
    double r00 = w * w + i * i - j * j - k * k, r01 = 2.0 * (i * j - w * k), r02 = 2.0 * (i * k + w * j);
    double r10 = 2.0 * (i * j + w * k), r11 = w * w - i * i + j * j - k * k, r12 = 2.0 * (j * k - w * i);
    double r20 = 2.0 * (i * k - w * j), r21 = 2.0 * (j * k + w * i), r22 = w * w - i * i - j * j + k * k;
    for (int row = 0; row < 3; row++) {
        double *o = c + 3 * row, a0 = o[0], a1 = o[1], a2 = o[2];
        o[0] = a0 * r00 + a1 * r10 + a2 * r20;
        o[1] = a0 * r01 + a1 * r11 + a2 * r21;
        o[2] = a0 * r02 + a1 * r12 + a2 * r22;
    }
    double s00 = c[0] * c[0] + c[3] * c[3] + c[6] * c[6];
    double s11 = c[1] * c[1] + c[4] * c[4] + c[7] * c[7];
    double s22 = c[2] * c[2] + c[5] * c[5] + c[8] * c[8];
    double s01 = c[0] * c[1] + c[3] * c[4] + c[6] * c[7];
    double s02 = c[0] * c[2] + c[3] * c[5] + c[6] * c[8];
    double s12 = c[1] * c[2] + c[4] * c[5] + c[7] * c[8];
    for (int row = 0; row < 3; row++) {
        double *o = c + 3 * row, a0 = o[0], a1 = o[1], a2 = o[2];
        o[0] = 0.5 * (a0 * (3.0 - s00) - a1 * s01 - a2 * s02);
        o[1] = 0.5 * (a1 * (3.0 - s11) - a0 * s01 - a2 * s12);
        o[2] = 0.5 * (a2 * (3.0 - s22) - a0 * s02 - a1 * s12);
    }
}

static double vertical_rate(const double *u, double ex, double ey, double ez, double tx, double ty) {
    double rate = u[2] - u[1] * (EARTH_RATE * ez);
    if (u[0] != 0.0)
        rate += u[0] * ez * (tx * ex + ty * ey) / (ex * ex + ey * ey);
    return rate;
}

static void turn_attitude(double *x, double px, double py, double pz, double zx, double zy, double zz) {
    quat q = {x[0], x[1], x[2], x[3]};
    q = multiply(multiply(exponential(-zx, -zy, -zz), q), exponential(px, py, pz));
    double norm = 1.0 / sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    x[0] = q.w * norm, x[1] = q.x * norm, x[2] = q.y * norm, x[3] = q.z * norm;
}

static void strapdown(double *x, const double *inc, double dt, const double *u, double *mid) {
    double qw = x[0], qx = x[1], qy = x[2], qz = x[3], vx = x[4], vy = x[5], vz = x[6];
    double px = inc[0], py = inc[1], pz = inc[2], bx = inc[3], by = inc[4], bz = inc[5];
    double c00 = qw * qw + qx * qx - qy * qy - qz * qz, c01 = 2.0 * (qx * qy - qw * qz);
    double c02 = 2.0 * (qx * qz + qw * qy), c10 = 2.0 * (qx * qy + qw * qz);
    double c11 = qw * qw - qx * qx + qy * qy - qz * qz, c12 = 2.0 * (qy * qz - qw * qx);
    double c20 = 2.0 * (qx * qz - qw * qy), c21 = 2.0 * (qy * qz + qw * qx);
    double c22 = qw * qw - qx * qx - qy * qy + qz * qz;
    double sx = c00 * bx + c01 * by + c02 * bz;
    double sy = c10 * bx + c11 * by + c12 * bz;
    double sz = c20 * bx + c21 * by + c22 * bz;
    double wcx = u[3], wcy = u[4], wcz = u[5];
    double ox = u[6], oy = u[7], oz = u[8], level = u[9], vertical = u[10];
    double h_ext = u[11], k1 = u[12], k2 = u[13], k3 = u[14];

    double half = 0.5 * dt, kxx, kxy, kyy;
    double ex = x[13], ey = x[14], ez = x[15], h = x[16], a_h = x[17];
    curvature(ex, ey, ez, h, &kxx, &kxy, &kyy);
    double north = gravity_north(ez, 1.0, h);
    double tx = -kxy * vx - kyy * vy, ty = kxx * vx + kxy * vy;
    double tz = vertical_rate(u, ex, ey, ez, tx, ty);
    double ux = 2.0 * EARTH_RATE * ex + tx + wcx;
    double uy = 2.0 * EARTH_RATE * ey + ty + wcy;
    double uz = 2.0 * EARTH_RATE * ez + tz + wcz;
    double miss = h - h_ext;
    double fall = normal_gravity(ez, h) + vertical * (vz - oz) + k2 * miss + a_h;
    double mx = vx + 0.5 * (sx + (north * ex - (uy * vz - uz * vy) - level * (vx - ox)) * dt);
    double my = vy + 0.5 * (sy + (north * ey - (uz * vx - ux * vz) - level * (vy - oy)) * dt);
    double mz = vz + 0.5 * (sz - (fall + (ux * vy - uy * vx)) * dt);
    double gx = ex - (ty * ez - tz * ey) * half;
    double gy = ey - (tz * ex - tx * ez) * half;
    double gz = ez - (tx * ey - ty * ex) * half;
    double h_mid = h + half * (mz - k1 * miss), a_mid = a_h + half * k3 * miss;
    curvature(gx, gy, gz, h_mid, &kxx, &kxy, &kyy);
    tx = -kxy * mx - kyy * my, ty = kxx * mx + kxy * my;
    tz = vertical_rate(u, gx, gy, gz, tx, ty);
    double ix = EARTH_RATE * gx, iy = EARTH_RATE * gy, iz = EARTH_RATE * gz;
    north = gravity_north(gz, 1.0, h_mid);
    double gravity = normal_gravity(gz, h_mid);
    miss = h_mid - h_ext;

    double zx = (ix + tx + wcx) * dt, zy = (iy + ty + wcy) * dt, zz = (iz + tz + wcz) * dt;
    ux = 2.0 * ix + tx + wcx, uy = 2.0 * iy + ty + wcy, uz = 2.0 * iz + tz + wcz;
    double fx = sx - 0.5 * (zy * sz - zz * sy);
    double fy = sy - 0.5 * (zz * sx - zx * sz);
    double fz = sz - 0.5 * (zx * sy - zy * sx);
    fall = gravity + vertical * (mz - oz) + k2 * miss + a_mid;
    double nx = vx + fx + (north * gx - (uy * mz - uz * my) - level * (mx - ox)) * dt;
    double ny = vy + fy + (north * gy - (uz * mx - ux * mz) - level * (my - oy)) * dt;
    double nz = vz + fz + (-fall - (ux * my - uy * mx)) * dt;

    double ax = 0.5 * (vx + nx), ay = 0.5 * (vy + ny);
    double h_new = h + (0.5 * (vz + nz) - k1 * miss) * dt;
    curvature(gx, gy, gz, 0.5 * (h + h_new), &kxx, &kxy, &kyy);
    tx = -kxy * ax - kyy * ay, ty = kxx * ax + kxy * ay;
    tz = vertical_rate(u, gx, gy, gz, tx, ty);
    rotate_columns(x + 7, tx * dt, ty * dt, tz * dt);
    x[4] = nx, x[5] = ny, x[6] = nz, x[16] = h_new, x[17] = a_h + k3 * miss * dt;

    turn_attitude(x, px, py, pz, (ix + tx + wcx) * dt, (iy + ty + wcy) * dt, (iz + tz + wcz) * dt);

    double hx = 0.5 * px, hy = 0.5 * py, hz = 0.5 * pz;
    mid[0] = c00 + c01 * hz - c02 * hy, mid[1] = c01 + c02 * hx - c00 * hz, mid[2] = c02 + c00 * hy - c01 * hx;
    mid[3] = c10 + c11 * hz - c12 * hy, mid[4] = c11 + c12 * hx - c10 * hz, mid[5] = c12 + c10 * hy - c11 * hx;
    mid[6] = c20 + c21 * hz - c22 * hy, mid[7] = c21 + c22 * hx - c20 * hz, mid[8] = c22 + c20 * hy - c21 * hx;
    mid[9] = fx / dt, mid[10] = fy / dt, mid[11] = fz / dt;
    mid[12] = ix, mid[13] = iy, mid[14] = iz, mid[15] = tx, mid[16] = ty, mid[17] = tz;
    mid[18] = kxx, mid[19] = kxy, mid[20] = kyy;
    mid[21] = ax, mid[22] = ay, mid[23] = 0.5 * (vz + nz);
    double r_m, r_n;
    radii(gz, &r_m, &r_n);
    mid[24] = 2.0 * gravity / (sqrt(r_m * r_n) + h_mid);
}

void integrate(double *x, const double *samples, long count, double dt_sample, int n, const double *u, double *mid) {
    double d[36], inc[6];
    for (long k = 0; k < count / n; k++) {
        for (int i = 0; i < n; i++)
            for (int j = 0; j < 3; j++) {
                d[3 * i + j] = samples[6 * (k * n + i) + j];
                d[3 * (n + i) + j] = samples[6 * (k * n + i) + 3 + j];
            }
        increments(d, n, inc);
        strapdown(x, inc, n * dt_sample, u, mid);
    }
}
