/* Where walls are nearest (as arithmetic/basics.py of holdfast has it). A wall is x0, y0, x1, y1. */

/* The share of the way from a to b that is nearest to (x, y), and the distance squared. */
static double hf_foot(double x, double y, double ax, double ay, double bx, double by,
                      double *squared) {
    const double dx = bx - ax, dy = by - ay, size = dx * dx + dy * dy;
    double s = size > 0.0 ? ((x - ax) * dx + (y - ay) * dy) / size : 0.0;
    s = s < 0.0 ? 0.0 : s;
    s = s > 1.0 ? 1.0 : s;
    *squared = (x - ax - s * dx) * (x - ax - s * dx) + (y - ay - s * dy) * (y - ay - s * dy);
    return s;
}

/* Twice the area of the triangle, positive if it is counterclockwise. */
static double hf_turn(double ax, double ay, double bx, double by, double x, double y) {
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax);
}

/* Coordinate k of the point of the walls that is nearest to (x, y). */
static inline double hf_nearest_on_walls(int k, double x, double y, const double *ends,
                                         int count) {
    double found[2] = {x, y}, least = INFINITY;
    for (int j = 0; j < count; j++) {
        const double *w = ends + 4 * j;
        double squared;
        const double s = hf_foot(x, y, w[0], w[1], w[2], w[3], &squared);
        const double wx = w[0] + s * (w[2] - w[0]), wy = w[1] + s * (w[3] - w[1]);
        squared = (x - wx) * (x - wx) + (y - wy) * (y - wy);
        if (squared < least) {
            least = squared;
            found[0] = wx;
            found[1] = wy;
        }
    }
    return found[k];
}

/* The corner or side of closed polygons that is nearest: 1 on a side or -1 at a corner, 1 outside
 * the polygons or -1 inside, the corner or the beginning of the side, the normal on its right. */
static inline double hf_nearest_face(int k, double x, double y, const double *ends, int count) {
    double found[6] = {1.0, 1.0, 0.0, 0.0, 0.0, 0.0}, least = INFINITY;
    for (int j = 0; j < count; j++) {
        const double ax = ends[4 * j], ay = ends[4 * j + 1];
        const double bx = ends[4 * j + 2], by = ends[4 * j + 3];
        const double dx = bx - ax, dy = by - ay, size = sqrt(dx * dx + dy * dy);
        double squared;
        const double s = hf_foot(x, y, ax, ay, bx, by, &squared);
        if (squared < least) {
            least = squared;
            found[0] = s > 0.0 && s < 1.0 ? 1.0 : -1.0;
            found[2] = s >= 1.0 ? bx : ax;
            found[3] = s >= 1.0 ? by : ay;
            found[4] = dy / size;
            found[5] = -dx / size;
        }
        const double turn = hf_turn(ax, ay, bx, by, x, y);
        if ((ay <= y && by > y && turn > 0.0) || (by <= y && ay > y && turn < 0.0))
            found[1] = -found[1];
    }
    return found[k];
}

/* Where the line from a to b is nearest to a wall: the share of the way, the point of the wall
 * (k = 1, 2), and -1 where a wall crosses the line, else 1. */
static inline double hf_nearest_to_sight(int k, double ax, double ay, double bx, double by,
                                         const double *ends, int count) {
    double found[4] = {0.0, ax, ay, 1.0}, least = INFINITY;
    for (int j = 0; j < count; j++) {
        const double px = ends[4 * j], py = ends[4 * j + 1];
        const double qx = ends[4 * j + 2], qy = ends[4 * j + 3];
        const double one = hf_turn(ax, ay, bx, by, px, py), two = hf_turn(ax, ay, bx, by, qx, qy);
        const double three = hf_turn(px, py, qx, qy, ax, ay);
        const double four = hf_turn(px, py, qx, qy, bx, by);
        const double side = one * two < 0.0 && three * four < 0.0 ? -1.0 : 1.0;
        const double line[2][2] = {{ax, ay}, {bx, by}}, wall[2][2] = {{px, py}, {qx, qy}};
        double at[3] = {0.0, px, py}, shortest = INFINITY, squared;
        for (int end = 0; end < 2; end++) { /* from the ends of the line */
            const double w = hf_foot(line[end][0], line[end][1], px, py, qx, qy, &squared);
            if (squared < shortest) {
                shortest = squared;
                at[0] = end;
                at[1] = px + w * (qx - px);
                at[2] = py + w * (qy - py);
            }
        }
        for (int end = 0; end < 2; end++) { /* and from those of the wall */
            const double s = hf_foot(wall[end][0], wall[end][1], ax, ay, bx, by, &squared);
            if (squared < shortest) {
                shortest = squared;
                at[0] = s;
                at[1] = wall[end][0];
                at[2] = wall[end][1];
            }
        }
        if (side * shortest < least) {
            least = side * shortest;
            for (int i = 0; i < 3; i++) found[i] = at[i];
            found[3] = side;
        }
    }
    return found[k];
}
