// Rigid transforms and projections in float64. Matrices are arrays of rows. `a_T_b` maps points of frame b to frame a.

export const NEAREST_DEPTH_M = 0.1; // points nearer to the camera's plane, or behind it, are not visible

export function multiply(a, b) {
  return a.map((row) => b[0].map((_, j) => row.reduce((sum, value, k) => sum + value * b[k][j], 0)));
}

export function transpose(a) {
  return a[0].map((_, j) => a.map((row) => row[j]));
}

export function identity(size) {
  return Array.from({ length: size }, (_, i) => Array.from({ length: size }, (_, j) => (i === j ? 1 : 0)));
}

/** The rotation (3, 3) of a transform (4, 4). */
export function rotationOf(a_T_b) {
  return a_T_b.slice(0, 3).map((row) => row.slice(0, 3));
}

export function determinant([[a, b, c], [d, e, f], [g, h, i]]) {
  return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
}

/** Return `b_T_a` of a rigid transform: its rotation is transposed, which is exact. */
export function inverse(a_T_b) {
  const b_R_a = transpose(rotationOf(a_T_b));
  const rows = b_R_a.map((row) => [...row, -(row[0] * a_T_b[0][3] + row[1] * a_T_b[1][3] + row[2] * a_T_b[2][3])]);
  return [...rows, [0, 0, 0, 1]];
}

/**
 * Return a transform (4, 4) with its rotation R replaced by U Vᵀ, where R = U S Vᵀ is the singular value decomposition.
 * U Vᵀ is the orthonormal factor of R's polar decomposition. Newton's iteration X ← (X + X⁻ᵀ) / 2 converges to it
 * quadratically (Higham, Functions of Matrices, section 8.3).
 */
export function nearestRigid(a_T_b) {
  let rotation = rotationOf(a_T_b);
  for (let step = 0; step < 20; step += 1) {
    const inverseTransposed = cofactors(rotation).map((row) => row.map((value) => value / determinant(rotation)));
    const next = rotation.map((row, i) => row.map((value, j) => (value + inverseTransposed[i][j]) / 2));
    const change = Math.max(...next.flat().map((value, k) => Math.abs(value - rotation.flat()[k])));
    rotation = next;
    if (change < 1e-15) break;
  }
  return [...rotation.map((row, i) => [...row, a_T_b[i][3]]), [0, 0, 0, 1]];
}

function cofactors([[a, b, c], [d, e, f], [g, h, i]]) {
  return [
    [e * i - f * h, f * g - d * i, d * h - e * g],
    [c * h - b * i, a * i - c * g, b * g - a * h],
    [b * f - c * e, c * d - a * f, a * e - b * d],
  ];
}

/** The angle [rad] of a rotation (3, 3), from 0 to pi. */
export function rotationAngle(rotation) {
  const cosine = (rotation[0][0] + rotation[1][1] + rotation[2][2] - 1) / 2;
  return Math.acos(Math.min(1, Math.max(-1, cosine)));
}

/**
 * The eight corners [m] of a box x y z w l h [m], yaw [rad]: the bottom in the order front left, front right, rear
 * right, rear left; then the top in the same order. The length is along the heading.
 */
export function boxCorners([x, y, z, width, length, height, yaw]) {
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  const corner = (along, across, up) => {
    const [forward, left] = [(along * length) / 2, (across * width) / 2];
    return [x + forward * cos - left * sin, y + forward * sin + left * cos, z + (up * height) / 2];
  };
  const ground = [
    [1, 1],
    [1, -1],
    [-1, -1],
    [-1, 1],
  ];
  return [-1, 1].flatMap((up) => ground.map(([along, across]) => corner(along, across, up)));
}

/** Return a point (3) [m] as homogeneous pixels (3) by a projection (3, 4). */
export function projectHomogeneous(image_T_ego, [x, y, z]) {
  return image_T_ego.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]);
}

/**
 * Project a line between two points (3) [m] to two pixels (2), after clipping it at a depth of `NEAREST_DEPTH_M`.
 * Returns undefined if the whole line is nearer.
 */
export function projectLine(image_T_ego, start, end) {
  let [a, b] = [projectHomogeneous(image_T_ego, start), projectHomogeneous(image_T_ego, end)];
  if (a[2] < NEAREST_DEPTH_M && b[2] < NEAREST_DEPTH_M) return undefined;
  if (a[2] < NEAREST_DEPTH_M) a = clipped(a, b);
  else if (b[2] < NEAREST_DEPTH_M) b = clipped(b, a);
  return [a, b].map(([u, v, depth]) => [u / depth, v / depth]);
}

/** Project a convex polygon (K, 3) [m] to pixels, after clipping it at a depth of `NEAREST_DEPTH_M`. */
export function projectPolygon(image_T_ego, points) {
  const homogeneous = points.map((point) => projectHomogeneous(image_T_ego, point));
  const kept = homogeneous.flatMap((point, index) => {
    const next = homogeneous[(index + 1) % homogeneous.length];
    const [isIn, isNextIn] = [point[2] >= NEAREST_DEPTH_M, next[2] >= NEAREST_DEPTH_M];
    const crossing = isIn === isNextIn ? [] : [isIn ? clipped(next, point) : clipped(point, next)];
    return isIn ? [point, ...crossing] : crossing;
  });
  return kept.map(([u, v, depth]) => [u / depth, v / depth]);
}

/** The point between `near` and `far` (homogeneous pixels) whose depth is `NEAREST_DEPTH_M`. */
function clipped(near, far) {
  const share = (NEAREST_DEPTH_M - near[2]) / (far[2] - near[2]);
  return near.map((value, k) => value + share * (far[k] - value));
}
