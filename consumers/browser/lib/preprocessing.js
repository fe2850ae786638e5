// From the images and calibrations of a frame to the tensors of the graphs: see "Preprocessing" in docs/frame-steps.md.

import { SceneError } from './errors.js';
import { multiply } from './geometry.js';
import { crop, halve, resizeArea, resizeLinear, roundHalfToEven } from './resize.js';

const MAX_HALVINGS = 2;
const MAX_SCALED_PX = 100_000_000; // of a scaled image, before the cut

/**
 * @param {import('./scene.js').Frame} frame
 * @param {Map<string, object | null>} images of the cameras, BGR; null for a lost one
 * @param {object} manifest
 * @returns {{images: Uint8Array, image_T_ego: Float32Array, camera_valid: Uint8Array}} the tensors of shapes
 *   (N, H, W, 3), (N, 3, 4) and (N)
 */
export function prepare(frame, images, manifest) {
  const { preprocessing, num_cameras: numCameras } = manifest;
  const pixels = preprocessing.width_px * preprocessing.height_px * 3;
  const inputs = {
    images: new Uint8Array(numCameras * pixels),
    image_T_ego: new Float32Array(numCameras * 12),
    camera_valid: new Uint8Array(numCameras),
  };
  [...frame.cameras].forEach(([name, camera], slot) => {
    inputs.image_T_ego.set(networkProjection(camera, preprocessing).flat(), slot * 12);
    const image = images.get(name);
    if (image === null) return;
    inputs.images.set(toNetworkImage(image, preprocessing).data, slot * pixels);
    inputs.camera_valid[slot] = 1;
  });
  return inputs;
}

/** The projection (3, 4) from the ego frame to pixels of the network's image, in float64. */
export function networkProjection(camera, preprocessing) {
  const { width, height, left, top } = scaledSize(camera.width_px, camera.height_px, preprocessing);
  const resized_T_image = [
    [width / camera.width_px, 0, -left],
    [0, height / camera.height_px, -top],
    [0, 0, 1],
  ];
  return multiply(multiply(resized_T_image, camera.intrinsics_px), camera.camera_T_ego.slice(0, 3));
}

/** Resize an image so that it covers the network's image, and crop it to that. */
export function toNetworkImage(image, preprocessing) {
  const { width, height, left, top } = scaledSize(image.width, image.height, preprocessing);
  const { width_px: networkWidth, height_px: networkHeight } = preprocessing;
  const halvings = numHalvings(image, width, height, preprocessing);
  if (halvings !== undefined) {
    // Every pixel is the mean of a separate block, so cropping first gives the same pixels with less work.
    const factor = 2 ** halvings;
    let part = crop(image, left * factor, top * factor, networkWidth * factor, networkHeight * factor);
    for (let i = 0; i < halvings; i += 1) part = halve(part);
    return part;
  }
  const resize = width < image.width ? resizeArea : resizeLinear;
  return crop(resize(image, width, height), left, top, networkWidth, networkHeight);
}

/** The size of the scaled image that covers the network's image, and where the crop starts in it. */
export function scaledSize(imageWidth, imageHeight, { width_px: networkWidth, height_px: networkHeight }) {
  const scale = Math.max(networkWidth / imageWidth, networkHeight / imageHeight);
  const [width, height] = [roundHalfToEven(imageWidth * scale), roundHalfToEven(imageHeight * scale)];
  if (width * height > MAX_SCALED_PX) {
    const expected = "proportions like those of the network's input";
    throw new SceneError('image size', expected, `${imageWidth}x${imageHeight} px`, 'Crop the image.');
  }
  return { width, height, left: Math.floor((width - networkWidth) / 2), top: height - networkHeight };
}

/** How many halvings lead exactly to the scaled size; undefined if none do. */
function numHalvings(image, width, height, preprocessing) {
  const most = preprocessing.resize_shrinking === 'area by halvings' ? MAX_HALVINGS : 0;
  for (let halvings = 0; halvings <= most; halvings += 1) {
    if (image.width === width << halvings && image.height === height << halvings) return halvings;
  }
  return undefined;
}
