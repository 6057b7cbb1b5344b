// A depth picture in false colours, with a bar that tells which stands for which distance.

import { drawScale } from "./color_scale.js";
import { look, distance } from "./depth_colors.js";
import { image, decode } from "./image.js";

export const depth = {
  ...image,
  id: "depth",
  // the readings are kept: other colours need no other frame
  keeps: true,

  look: (props) => look(props),

  restyle(layer, changed) {
    const style = JSON.stringify(layer.vis.props ?? {});
    if (layer.style !== undefined && layer.style !== style && layer.frame) decode(layer, layer.frame, changed);
    layer.style = style;
  },

  // Over all pictures and shapes.
  finish(ctx, { picture, vis }, { width, height }) {
    if (picture?.range && vis.props?.scale !== false) drawScale(ctx, width, height, picture);
  },

  reading(value, { unit }, vis) {
    const none = value === look(vis.props).invalid;
    return `${value}${none ? ", no reading" : unit ? `, ${distance(value, unit)}` : ""}`;
  },
};
