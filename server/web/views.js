// The views of a picture. A view names the columns that it needs and turns them into values, which a palette
// colours, or into colours. To add one, add an entry.
import { COUNTERS, MEASURES } from "./lists.js";
import { idColour } from "./palette.js";

const NONE = 0xffffffff;
const BACKGROUND = [46, 46, 46];
const capital = (text) => text[0].toUpperCase() + text.slice(1);

const counters = Object.entries(COUNTERS).map(([name, title]) => ({
  id: name, group: "Cost", label: capital(title), counter: true,
  fields: ({ level }) => [level === "" ? name : `${name}.${level}`],
  value: (columns, i, field) => columns[field][i],
}));

/** Measures of heat maps; not a number of an orthographic camera, which they do not have. */
const measures = Object.entries(MEASURES).map(([name, title]) => ({
  id: name, group: "Cost", label: capital(title), measured: true,
  fields: ({ camera }) => (camera?.projection === "orthographic" ? ["ng"] : [name]),
  value: (columns, i) => columns[name]?.[i] ?? NaN,
}));

/** Colours hits by one column of numbers; what has none stays background. */
const ids = (id, label, field, none = NONE) => ({
  id, label, group: "Identity", fields: () => ["t", field],
  colour: (columns, i) => columns.t[i] === Infinity || columns[field][i] === none
    ? BACKGROUND : idColour(Number(BigInt.asUintN(32, BigInt(columns[field][i])))),
});

/** Values of what was hit, for the palette. */
const structure = (id, label, field, value) => ({ id, label, group: "Structure", fields: () => [field, "t"],
  value: (columns, i) => columns.t[i] === Infinity ? NaN : value(columns, i) });

const OPACITIES = { OPAQUE: [86, 130, 170], MASK: [240, 150, 50], BLEND: [200, 90, 200] };
const SIDES = { front: [86, 156, 214], back: [230, 126, 60] };

/** Views of colours that mean something have a `key`: pairs of a word and its colour. Those of places have the range `fromLeast` value: nothing lies at 0. */
export const VIEWS = [
  ...counters,
  ...measures,
  { id: "picture", group: "Picture", label: "Picture (base colour)", render: true, fields: () => ["ng"],
    colour: (columns, i) => columns.rgba ? columns.rgba.subarray(4 * i, 4 * i + 3) : null },
  { id: "lit", group: "Picture", label: "Lit (lights and shadows)", lit: true, fields: () => ["ng"], colour: () => null },
  { id: "depth", group: "Geometry", label: "Depth (t)", fromLeast: true, fields: () => ["t"],
    value: (columns, i) => columns.t[i] === Infinity ? NaN : columns.t[i] },
  { id: "normal", group: "Geometry", label: "Normals", key: [["+X", [255, 128, 128]], ["+Y", [128, 255, 128]], ["+Z", [128, 128, 255]]], fields: () => ["ng"],
    colour: ({ ng }, i) => ng[3 * i] || ng[3 * i + 1] || ng[3 * i + 2]
      ? [0, 1, 2].map((k) => Math.round(127.5 + 127.5 * ng[3 * i + k])) : BACKGROUND },
  { id: "side", group: "Geometry", label: "Side that was hit", key: [["front", SIDES.front], ["back", SIDES.back]], fields: () => ["t", "front"],
    colour: ({ t, front }, i) => t[i] === Infinity ? BACKGROUND : front[i] ? SIDES.front : SIDES.back },
  ids("placement", "One colour per placement", "path", 0xffffffffffffffffn),
  ids("inst", "One colour per instance (outermost)", "inst"),
  ids("uid", "One colour per instance (innermost)", "uid"),
  ids("material", "One colour per material", "material"),
  ids("geom", "One colour per geometry", "geom"),
  ids("prim", "One colour per primitive", "prim"),
  ids("object", "One colour per object", "object"),
  structure("box_share", "Triangle's share of its box", "box_share", (columns, i) => columns.box_share[i]),
  structure("tree_depth", "Tree depth of the triangle", "tree_depth", (columns, i) => columns.tree_depth[i] === NONE ? NaN : columns.tree_depth[i]),
  structure("object_instances", "Instances of the object", "object", (columns, i) => Number(facts.objects[columns.object[i]]?.placements ?? NaN)),
  structure("object_triangles", "Triangles of the object", "object", (columns, i) => facts.objects[columns.object[i]]?.triangles ?? NaN),
  structure("object_depth", "Depth of the object's tree", "object", (columns, i) => facts.objects[columns.object[i]]?.height ?? NaN),
  ids("mask", "Mask of the instance", "mask", null),
  { id: "opacity", group: "Structure", label: "Alpha mode (opaque, masked, blended)", key: Object.entries(OPACITIES), fields: () => ["t", "material"],
    colour: ({ t, material }, i) => t[i] === Infinity ? BACKGROUND : OPACITIES[facts.materials[material[i]]?.alpha] ?? OPACITIES.OPAQUE },
];

/** Facts about objects and materials that views of structure need, by their numbers; model.js fills them. */
export const facts = { objects: [], materials: [] };

export const viewOf = (id) => VIEWS.find((view) => view.id === id) ?? VIEWS.find((view) => view.id === "total");

/** Returns the views as options of a select, in groups. */
export function viewOptions() {
  const groups = new Map();
  for (const { id, label, group } of VIEWS) {
    if (!groups.has(group)) groups.set(group, []);
    groups.get(group).push([id, label]);
  }
  return [...groups].map(([group, options]) => ({ group, options }));
}
