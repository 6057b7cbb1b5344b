// A depth image in false colors, with a scale of distances.

import { drawScale } from "./color_scale.js";
import { depthStyle, formatDistance } from "./depth_colors.js";
import { image, decodeImage } from "./image.js";

export const depth = {
  ...image,
  id: "depth",
  // the readings are kept, so that new colors need no new frame
  keeps: true,

  depthStyle: (props) => depthStyle(props),

  restyle(layer, changed) {
    const style = JSON.stringify(layer.vis.props ?? {});
    if (layer.style !== undefined && layer.style !== style && layer.frame) decodeImage(layer, layer.frame, changed);
    layer.style = style;
  },

  // Drawn over all images and shapes.
  drawOverlay(ctx, { picture, vis }, { width, height }) {
    if (picture?.range && vis.props?.scale !== false) drawScale(ctx, width, height, picture);
  },

  readingText(value, { unit }, vis) {
    const none = value === depthStyle(vis.props).invalid;
    return `${value}${none ? ", no reading" : unit ? `, ${formatDistance(value, unit)}` : ""}`;
  },
};
