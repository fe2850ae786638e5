// A line of `results.jsonl`, as `duospacenet run` writes it, but without rounding and without nuScenes attributes.

/**
 * @param {import('./scene.js').Frame} frame
 * @param {object} result of `Stream.step`
 */
export function frameResult(frame, result) {
  const { queries, map_cells: cells } = result.dropped;
  return {
    scene: frame.scene,
    token: frame.token,
    timestamp_s: frame.timestamp_s,
    global_T_ego: frame.global_T_ego,
    history: result.history,
    skipped: result.skipped,
    degraded: queries + cells > 0,
    dropped: { queries, map_cells: cells },
    boxes: result.boxes.map(boxResult),
    maps: {},
  };
}

function boxResult({ class: name, score, box }) {
  return {
    class: name,
    score,
    center_m: box.slice(0, 3),
    size_wlh_m: box.slice(3, 6),
    yaw_rad: box[6],
    velocity_m_s: box.slice(7, 9),
  };
}
