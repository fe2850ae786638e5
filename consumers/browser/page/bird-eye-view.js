// The bird's-eye view: boxes and the map from above. Forward is up, left is left.

import { boxCorners } from '../lib/geometry.js';
import { MAP_COLOURS, OTHER_MAP_COLOUR } from './box-style.js';
import { fit, trace } from './canvas.js';

const GROUND = '#191c22';
const RING = 'rgb(255 255 255 / 20%)';
const RING_TEXT = 'rgb(255 255 255 / 62%)';
const EGO = '#f0f2f5';
const RING_STEP_M = 10;
const SLOWEST_ARROW_M_S = 0.3; // slower boxes have no arrow
// The outline of a car, x forward and y left. The origin of the ego frame is at its rear axle.
const EGO_OUTLINE_M = [
  [3.2, 0.45],
  [3.2, -0.45],
  [2.6, -0.9],
  [-0.9, -0.9],
  [-0.9, 0.9],
  [2.6, 0.9],
];
const EGO_HEADING_M = [
  [2.6, 0],
  [1.2, 0.6],
  [1.2, -0.6],
];

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{box: number[], colour: string}[]} boxes in the ego frame
 * @param {Map<string, Float32Array>} maps probabilities (X, Y) by map class; empty if they are not shown
 * @param {{size: number[], lower_m: number[], upper_m: number[]}} perception
 */
export function drawBirdEyeView(canvas, boxes, maps, perception) {
  const { context, width, height } = fit(canvas);
  const range_m = Math.max(...[0, 1].flatMap((axis) => [-perception.lower_m[axis], perception.upper_m[axis]]));
  const scale = Math.min(width, height) / (2 * range_m);
  const place = ([x, y]) => [width / 2 - y * scale, height / 2 - x * scale];
  context.fillStyle = GROUND;
  context.fillRect(0, 0, width, height);
  drawMaps(context, maps, perception, place);
  drawRings(context, range_m, scale, place);
  for (const box of boxes) drawBox(context, box, place);
  drawEgo(context, place);
}

function drawMaps(context, maps, { size, lower_m: lower, upper_m: upper }, place) {
  const [rows, columns] = size;
  for (const [name, probabilities] of maps) {
    const [red, green, blue] = MAP_COLOURS[name] ?? OTHER_MAP_COLOUR;
    const picture = new ImageData(columns, rows);
    for (let i = 0; i < rows; i += 1) {
      for (let j = 0; j < columns; j += 1) {
        // The first row of the picture is the farthest ahead, and its first column the farthest left.
        const to = 4 * ((rows - 1 - i) * columns + (columns - 1 - j));
        picture.data.set([red, green, blue, Math.round(255 * probabilities[i * columns + j])], to);
      }
    }
    const layer = new OffscreenCanvas(columns, rows);
    layer.getContext('2d').putImageData(picture, 0, 0);
    const [left, top] = place([upper[0], upper[1]]);
    const [right, bottom] = place([lower[0], lower[1]]);
    context.imageSmoothingEnabled = false; // one square per cell
    context.drawImage(layer, left, top, right - left, bottom - top);
  }
}

function drawRings(context, range_m, scale, place) {
  Object.assign(context, { strokeStyle: RING, fillStyle: RING_TEXT, lineWidth: 1 });
  Object.assign(context, {
    font: '11px system-ui, "DejaVu Sans", sans-serif',
    textAlign: 'left',
    textBaseline: 'middle',
  });
  const [x, y] = place([0, 0]);
  for (let radius = RING_STEP_M; radius < range_m; radius += RING_STEP_M) {
    context.beginPath();
    context.arc(x, y, radius * scale, 0, 2 * Math.PI);
    context.stroke();
    const diagonal = (radius * scale) / Math.SQRT2;
    context.fillText(`${radius} m`, x + diagonal + 3, y + diagonal + 4);
  }
}

function drawEgo(context, place) {
  context.beginPath();
  trace(context, EGO_OUTLINE_M.map(place), true);
  Object.assign(context, { strokeStyle: EGO, fillStyle: EGO, lineWidth: 1.5 });
  context.stroke();
  context.beginPath();
  trace(context, EGO_HEADING_M.map(place), true);
  context.fill();
}

function drawBox(context, { box, colour }, place) {
  const corners = boxCorners(box).slice(0, 4);
  const outline = corners.map(place);
  context.beginPath();
  trace(context, outline, true);
  Object.assign(context, { fillStyle: colour, strokeStyle: colour, lineWidth: 1.5, globalAlpha: 0.4 });
  context.fill();
  context.globalAlpha = 1;
  const front = [0, 1].map((axis) => (corners[0][axis] + corners[1][axis]) / 2);
  trace(context, [place(box), place(front)]);
  context.stroke();
  drawVelocity(context, box, place);
}

/** An arrow over the distance that is covered in one second. */
function drawVelocity(context, box, place) {
  const [x, y, vx, vy] = [box[0], box[1], box[7], box[8]];
  const speed = Math.hypot(vx, vy);
  if (!(speed >= SLOWEST_ARROW_M_S)) return;
  const end = [x + vx, y + vy];
  const barb = Math.min(1.2, 0.4 * speed) / speed;
  const sides = [0.5, -0.5].map((side) => [end[0] - barb * (vx + side * vy), end[1] - barb * (vy - side * vx)]);
  context.beginPath();
  trace(context, [[x, y], end].map(place));
  trace(context, [sides[0], end, sides[1]].map(place));
  context.stroke();
}
