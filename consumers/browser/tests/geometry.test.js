import assert from 'node:assert/strict';
import test from 'node:test';

import {
  boxCorners,
  inverse,
  multiply,
  nearestRigid,
  projectLine,
  projectPolygon,
  rotationAngle,
  rotationOf,
  transpose,
} from '../lib/geometry.js';

const CAMERA = [
  [100, 0, 50, 0],
  [0, 100, 40, 0],
  [0, 0, 1, 0],
]; // looks along z

function close(found, expected, tolerance = 1e-12) {
  found
    .flat()
    .forEach((value, index) =>
      assert.ok(Math.abs(value - expected.flat()[index]) <= tolerance, `${found} is not ${expected}`),
    );
}

function aboutZ(angle) {
  return [
    [Math.cos(angle), -Math.sin(angle), 0],
    [Math.sin(angle), Math.cos(angle), 0],
    [0, 0, 1],
  ];
}

test('the nearest rotation of a rounded rotation is orthonormal, and their quotient is symmetric', () => {
  const rounded = aboutZ(0.6).map((row, i) => [...row.map((value) => Number(value.toFixed(3))), i + 5]);
  const rigid = nearestRigid([...rounded, [0, 0, 0, 1]]);
  const rotation = rotationOf(rigid);
  close(
    multiply(rotation, transpose(rotation)),
    [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ],
    1e-15,
  );
  const stretch = multiply(
    transpose(rotation),
    rounded.map((row) => row.slice(0, 3)),
  ); // R = U Vᵀ leaves V S Vᵀ
  close(stretch, transpose(stretch), 1e-15);
  assert.deepEqual(
    rigid.map((row) => row[3]),
    [5, 6, 7, 1],
  );
});

test('the inverse of a pose undoes it', () => {
  const pose = [...aboutZ(0.3).map((row, i) => [...row, [600, -20, 1.5][i]]), [0, 0, 0, 1]];
  close(
    multiply(inverse(pose), pose),
    [
      [1, 0, 0, 0],
      [0, 1, 0, 0],
      [0, 0, 1, 0],
      [0, 0, 0, 1],
    ],
    1e-9,
  );
});

test('the angle of a rotation', () => {
  assert.ok(Math.abs(rotationAngle(aboutZ(-2)) - 2) < 1e-12);
  assert.equal(
    rotationAngle([
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1.0000001],
    ]),
    0,
  );
});

test('corners of a box: the length is along the heading', () => {
  const corners = boxCorners([10, 5, 1, 2, 4, 3, Math.PI / 2]);
  // It heads to the left, so its front is at y = 7, and its left side at x = 9.
  close(corners.slice(0, 2), [
    [9, 7, -0.5],
    [11, 7, -0.5],
  ]);
  close([corners[4]], [[9, 7, 2.5]]);
});

test('a line is clipped at the nearest depth', () => {
  assert.deepEqual(projectLine(CAMERA, [0, 0, 1], [1, 0, 2]), [
    [50, 40],
    [100, 40],
  ]);
  assert.equal(projectLine(CAMERA, [0, 0, 0.05], [1, 0, -2]), undefined);
  const [start] = projectLine(CAMERA, [1, 0, -0.9], [1, 0, 1.1]); // meets the depth 0.1 in the middle
  close([start], [[1050, 40]], 1e-9);
});

test('a polygon is clipped at the nearest depth', () => {
  const square = [
    [-1, 0, 1],
    [1, 0, 1],
    [1, 0, -1],
    [-1, 0, -1],
  ];
  close(
    projectPolygon(CAMERA, square),
    [
      [-50, 40],
      [150, 40],
      [1050, 40],
      [-950, 40],
    ],
    1e-9,
  );
  assert.deepEqual(
    projectPolygon(
      CAMERA,
      square.map(([x, y]) => [x, y, -1]),
    ),
    [],
  );
});
