// The panels of the cameras: images with boxes projected into them.

import {
  boxCorners,
  multiply,
  projectHomogeneous,
  projectLine,
  projectPolygon,
  NEAREST_DEPTH_M,
} from '../lib/geometry.js';
import { fit, trace } from './canvas.js';

const EDGES = [
  [0, 1],
  [1, 2],
  [2, 3],
  [3, 0],
  [4, 5],
  [5, 6],
  [6, 7],
  [7, 4],
  [0, 4],
  [1, 5],
  [2, 6],
  [3, 7],
];
const FRONT = [0, 1, 5, 4];
const LARGE_BOX_PX = 46; // smaller boxes have thin lines
const LABEL_PX = 14;
const LABEL_FONT = '600 11px system-ui, "DejaVu Sans", sans-serif';
const SAME_AZIMUTH_RAD = (5 * Math.PI) / 180;
const CENTRAL_RAD = (20 * Math.PI) / 180; // a camera that looks ahead or back, by its distance from that direction
const GAP_PX = 6;

export class CameraViews {
  /** @param {HTMLElement} place of the panels */
  constructor(place) {
    this.place = place;
    this.panels = new Map();
  }

  /**
   * Make the panels for the cameras of a frame, unless they are there, in the grid with the largest panels.
   * @param {{width: number, height: number} | undefined} room undefined if the page scrolls
   */
  layOut(cameras, room) {
    const aspect = Math.max(...[...cameras.values()].map((camera) => camera.width_px / camera.height_px));
    const grid = room ? largestGrid(cameras.size, aspect, room) : { columns: Math.min(2, cameras.size) };
    const names = grid.columns === 2 ? pairs(cameras) : cameraRows(cameras).flat();
    if (names.join('\n') !== [...this.panels.keys()].join('\n')) {
      this.panels = new Map(names.map((name) => [name, createPanel(name)]));
      this.place.replaceChildren(...[...this.panels.values()].map(({ figure }) => figure));
    }
    const { style } = this.place;
    style.setProperty('--columns', String(grid.columns));
    style.setProperty('--aspect', String(aspect));
    style.width = room ? `${grid.columns * grid.width + (grid.columns - 1) * GAP_PX}px` : '';
  }

  /**
   * @param {Map<string, object>} cameras of the frame
   * @param {Map<string, ImageBitmap>} pictures without those of lost cameras
   * @param {{box: number[], colour: string, score: number}[]} boxes in the ego frame
   */
  draw(cameras, pictures, boxes) {
    for (const [name, panel] of this.panels) drawPanel(panel, cameras.get(name), pictures.get(name), boxes);
  }
}

/** The number of columns with the largest panels, and the width of a panel. */
function largestGrid(count, aspect, room) {
  const grids = Array.from({ length: count }, (_, index) => {
    const [columns, rows] = [index + 1, Math.ceil(count / (index + 1))];
    const widest = (room.width - (columns - 1) * GAP_PX) / columns;
    const highest = (room.height - (rows - 1) * GAP_PX) / rows;
    return { columns, width: Math.floor(Math.max(40, Math.min(widest, highest * aspect))) };
  });
  return grids.reduce((best, grid) => (grid.width > best.width ? grid : best));
}

/** The cameras in two columns: those ahead and back, then those of the left and the right side in pairs. */
function pairs(cameras) {
  const azimuths = new Map([...cameras].map(([name, camera]) => [name, azimuth(camera)]));
  const names = [...azimuths.keys()].sort((a, b) => Math.abs(azimuths.get(a)) - Math.abs(azimuths.get(b)));
  const isCentral = (name) =>
    Math.min(Math.abs(azimuths.get(name)), Math.PI - Math.abs(azimuths.get(name))) < CENTRAL_RAD;
  const sides = names.filter((name) => !isCentral(name));
  const [left, right] = [
    sides.filter((name) => azimuths.get(name) > 0),
    sides.filter((name) => azimuths.get(name) <= 0),
  ];
  const paired = left.flatMap((name, index) => [name, right[index]].filter(Boolean));
  return [...names.filter(isCentral), ...paired, ...right.slice(left.length)];
}

function createPanel(name) {
  const [figure, canvas, caption] = ['figure', 'canvas', 'figcaption'].map((tag) => document.createElement(tag));
  figure.className = 'camera';
  caption.textContent = name;
  figure.append(canvas, caption);
  return { figure, canvas, caption };
}

/** The camera names of the front row and of the back row, each from left to right. */
function cameraRows(cameras) {
  const azimuths = new Map([...cameras].map(([name, camera]) => [name, azimuth(camera)]));
  const sorted = [...azimuths.values()].map(Math.abs).sort((a, b) => a - b);
  const largest = sorted[(sorted.length - 1) >> 1] + SAME_AZIMUTH_RAD;
  const names = [...azimuths.keys()];
  const front = names.filter((name) => Math.abs(azimuths.get(name)) <= largest);
  const back = names.filter((name) => Math.abs(azimuths.get(name)) > largest);
  const turn = (name) => (azimuths.get(name) + 2 * Math.PI) % (2 * Math.PI);
  return [front.sort((a, b) => azimuths.get(b) - azimuths.get(a)), back.sort((a, b) => turn(a) - turn(b))].filter(
    (row) => row.length > 0,
  );
}

/** The direction of a camera's axis in the ego frame [rad]: 0 ahead, positive to the left. */
function azimuth(camera) {
  return Math.atan2(camera.camera_T_ego[2][1], camera.camera_T_ego[2][0]);
}

function drawPanel({ canvas, caption }, camera, picture, boxes) {
  const { context, width, height } = fit(canvas);
  if (!picture) {
    context.fillStyle = '#9aa3b0';
    context.font = '600 17px system-ui, "DejaVu Sans", sans-serif';
    Object.assign(context, { textAlign: 'center', textBaseline: 'middle' });
    context.fillText(camera ? 'lost' : '', width / 2, height / 2);
    return;
  }
  const scale = Math.min(width / camera.width_px, height / camera.height_px);
  const [left, top] = [(width - scale * camera.width_px) / 2, (height - scale * camera.height_px) / 2];
  const [right, bottom] = [left + scale * camera.width_px, top + scale * camera.height_px];
  context.imageSmoothingQuality = 'high';
  context.drawImage(picture, left, top, right - left, bottom - top);
  context.save();
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.clip();
  const panel_T_image = [
    [scale, 0, left],
    [0, scale, top],
    [0, 0, 1],
  ];
  const panel_T_ego = multiply(multiply(panel_T_image, camera.intrinsics_px), camera.camera_T_ego.slice(0, 3));
  const view = { left, top, right, bottom };
  const labels = farToNear(boxes, panel_T_ego).map((box) => drawBox(context, panel_T_ego, box, view));
  const { offsetLeft: start, offsetTop: above, offsetWidth: across, offsetHeight: down } = caption;
  const taken = [{ left: start, right: start + across, top: above, bottom: above + down }];
  drawLabels(context, labels.filter(Boolean).reverse(), view, taken);
  context.restore();
}

function farToNear(boxes, panel_T_ego) {
  const placed = boxes.map((box) => {
    const corners = boxCorners(box.box);
    const depths = corners.map((corner) => projectHomogeneous(panel_T_ego, corner)[2]);
    return { ...box, corners, depth: depths.reduce((sum, depth) => sum + depth, 0), nearest: Math.max(...depths) };
  });
  return placed.filter((box) => box.nearest > NEAREST_DEPTH_M).sort((a, b) => b.depth - a.depth);
}

/** Draw a box. Returns the place of its label; undefined if it is outside of the image. */
function drawBox(context, panel_T_ego, { corners, colour, score }, view) {
  const heading = [middle(corners.slice(0, 4)), middle(corners.slice(0, 2))];
  const segments = [...EDGES.map(([a, b]) => [corners[a], corners[b]]), heading];
  const lines = segments.map(([a, b]) => projectLine(panel_T_ego, a, b)).filter(Boolean);
  const [xs, ys] = [0, 1].map((axis) => lines.flat().map((point) => point[axis]));
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  if (x1 < view.left || x0 > view.right || y1 < view.top || y0 > view.bottom) return undefined;
  context.beginPath();
  trace(
    context,
    projectPolygon(
      panel_T_ego,
      FRONT.map((corner) => corners[corner]),
    ),
    true,
  );
  Object.assign(context, { globalAlpha: 0.3, fillStyle: colour });
  context.fill();
  context.globalAlpha = 1;
  context.beginPath();
  for (const line of lines) trace(context, line);
  Object.assign(context, { lineWidth: y1 - y0 > LARGE_BOX_PX ? 2 : 1.2, strokeStyle: colour, lineJoin: 'round' });
  context.stroke();
  return { text: score.toFixed(2), x: (Math.max(x0, view.left) + Math.min(x1, view.right)) / 2, y: y0, colour };
}

/** Write the scores above the boxes. A label that would cover the caption or one of a nearer box is left out. */
function drawLabels(context, labels, view, taken) {
  Object.assign(context, { font: LABEL_FONT, textAlign: 'left', textBaseline: 'alphabetic' });
  for (const { text, x, y, colour } of labels) {
    const width = context.measureText(text).width + 6;
    const left = Math.min(Math.max(x - width / 2, view.left), view.right - width);
    const top = Math.min(Math.max(y - LABEL_PX - 1, view.top), view.bottom - LABEL_PX);
    const label = { left, right: left + width, top, bottom: top + LABEL_PX };
    if (taken.some((other) => overlap(label, other))) continue;
    taken.push(label);
    context.fillStyle = 'rgb(10 12 15 / 72%)';
    context.fillRect(left, top, width, LABEL_PX);
    context.fillStyle = colour;
    context.fillText(text, left + 3, top + LABEL_PX - 3);
  }
}

function overlap(one, other) {
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}

function middle(points) {
  return [0, 1, 2].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
}
