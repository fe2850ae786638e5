// The colours of classes, map classes and stages. Boxes have the colours of `duospacenet run --draw`.

const CLASS_COLOURS = {
  car: '#40a5ff',
  truck: '#ff9642',
  construction_vehicle: '#d6af3c',
  bus: '#ff5a78',
  trailer: '#b482ff',
  barrier: '#aab4be',
  motorcycle: '#ff69cd',
  bicycle: '#50e1eb',
  pedestrian: '#ffdc46',
  traffic_cone: '#ff5032',
};
const OTHER_COLOURS = Object.values(CLASS_COLOURS);

export const MAP_COLOURS = { drivable_area: [70, 84, 108], lane_boundary: [196, 178, 146] };
export const OTHER_MAP_COLOUR = [130, 110, 140];

/** The colour of a class. Classes that nuScenes does not have get one of the known colours by their position. */
export function classColour(name, classes) {
  if (Object.hasOwn(CLASS_COLOURS, name)) return CLASS_COLOURS[name];
  return OTHER_COLOURS[Math.max(0, classes.indexOf(name)) % OTHER_COLOURS.length];
}

/** A class name for readers: `traffic_cone` is "traffic cone". */
export function readable(name) {
  return name.replaceAll('_', ' ');
}
