// The panels of the cameras: images with boxes projected into them.

import { boxCorners, multiply, projectHomogeneous, projectLine, projectPolygon, NEAREST_DEPTH_M } from '../lib/geometry.js';
import { fit, trace } from './canvas.js';

const EDGES = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const FRONT = [0, 1, 5, 4];
const LARGE_BOX_PX = 46; // smaller boxes have thin lines
const LABEL_FONT = '600 11px system-ui, "DejaVu Sans", sans-serif';
const SAME_AZIMUTH_RAD = (5 * Math.PI) / 180;

export class CameraViews {
  /** @param {HTMLElement} place of the panels */
  constructor(place) {
    this.place = place;
    this.panels = new Map();
  }

  /** Make the panels for the cameras of a frame, unless they are there. */
  layOut(cameras) {
    const rows = cameraRows(cameras);
    const names = rows.flat();
    if (names.join('\n') === [...this.panels.keys()].join('\n')) return;
    this.place.style.setProperty('--columns', String(Math.max(...rows.map((row) => row.length))));
    this.panels = new Map(names.map((name) => [name, createPanel(name, cameras.get(name))]));
    this.place.replaceChildren(...[...this.panels.values()].map(({ figure }) => figure));
  }

  /**
   * @param {Map<string, object>} cameras of the frame
   * @param {Map<string, ImageBitmap>} pictures without those of lost cameras
   * @param {{box: number[], colour: string, score: number}[]} boxes in the ego frame
   */
  draw(cameras, pictures, boxes) {
    this.layOut(cameras);
    for (const [name, { canvas }] of this.panels) drawPanel(canvas, cameras.get(name), pictures.get(name), boxes);
  }
}

function createPanel(name, camera) {
  const [figure, canvas, caption] = ['figure', 'canvas', 'figcaption'].map((tag) => document.createElement(tag));
  figure.className = 'camera';
  figure.style.setProperty('--aspect', `${camera.width_px} / ${camera.height_px}`);
  caption.textContent = name;
  figure.append(canvas, caption);
  return { figure, canvas };
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
  return [
    front.sort((a, b) => azimuths.get(b) - azimuths.get(a)),
    back.sort((a, b) => turn(a) - turn(b)),
  ].filter((row) => row.length > 0);
}

/** The direction of a camera's axis in the ego frame [rad]: 0 ahead, positive to the left. */
function azimuth(camera) {
  return Math.atan2(camera.camera_T_ego[2][1], camera.camera_T_ego[2][0]);
}

function drawPanel(canvas, camera, picture, boxes) {
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
  const panel_T_image = [[scale, 0, left], [0, scale, top], [0, 0, 1]];
  const panel_T_ego = multiply(multiply(panel_T_image, camera.intrinsics_px), camera.camera_T_ego.slice(0, 3));
  for (const box of farToNear(boxes, panel_T_ego)) drawBox(context, panel_T_ego, box, { left, top, right, bottom });
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

function drawBox(context, panel_T_ego, { corners, colour, score }, view) {
  const heading = [middle(corners.slice(0, 4)), middle(corners.slice(0, 2))];
  const segments = [...EDGES.map(([a, b]) => [corners[a], corners[b]]), heading];
  const lines = segments.map(([a, b]) => projectLine(panel_T_ego, a, b)).filter(Boolean);
  const points = lines.flat();
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  if (x1 < view.left || x0 > view.right || y1 < view.top || y0 > view.bottom) return;
  context.beginPath();
  trace(context, projectPolygon(panel_T_ego, FRONT.map((corner) => corners[corner])), true);
  context.globalAlpha = 0.3;
  context.fillStyle = colour;
  context.fill();
  context.globalAlpha = 1;
  context.beginPath();
  for (const line of lines) trace(context, line);
  Object.assign(context, { lineWidth: y1 - y0 > LARGE_BOX_PX ? 2 : 1.2, strokeStyle: colour, lineJoin: 'round' });
  context.stroke();
  drawLabel(context, score.toFixed(2), x0, y0, colour, view);
}

/** Write a score above a box, inside the image. */
function drawLabel(context, text, x, y, colour, view) {
  Object.assign(context, { font: LABEL_FONT, textAlign: 'left', textBaseline: 'alphabetic' });
  const width = context.measureText(text).width + 6;
  const left = Math.min(Math.max(x, view.left), view.right - width);
  const top = Math.min(Math.max(y - 15, view.top), view.bottom - 15);
  context.fillStyle = 'rgb(10 12 15 / 70%)';
  context.fillRect(left, top, width, 15);
  context.fillStyle = colour;
  context.fillText(text, left + 3, top + 11.5);
}

function middle(points) {
  return [0, 1, 2].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
}
