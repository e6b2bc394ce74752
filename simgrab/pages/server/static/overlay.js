// What is drawn on an image: labels and measurements, in its pixels. Which of them show is switched by CSS.

import { svg } from "./dom.js";

const box = (kind, [x0, y0, x1, y1]) =>
  svg("rect", { class: kind, x: x0, y: y0, width: Math.max(x1 - x0, 0), height: Math.max(y1 - y0, 0) });

const path = (polygons) =>
  polygons.map((points) => `M${points.map((value, i) => (i % 2 ? `${value} ` : `${value},`)).join("")}Z`).join("");

/** Show the layers whose boxes are checked, and hide the others. */
export const switchLayers = () => {
  for (const one of document.querySelectorAll("[data-layer]")) document.body.classList.toggle(`no-${one.dataset.layer}`, !one.checked);
};

/** Make the drawing of a frame; `radius` is that of keypoints, as a share of the image's width. */
export const overlay = (drawn, radius = 0.009) => {
  const { width, height, truth, measured } = drawn;
  const parts = [];
  if (truth?.mask?.length) parts.push(svg("path", { class: "mask", d: path(truth.mask) }));
  if (truth?.box) parts.push(box("box", truth.box));
  for (const [name, u, v, seen] of truth?.keypoints ?? [])
    parts.push(svg("circle", { class: seen === 2 ? "keypoints" : "keypoints unseen", cx: u, cy: v, r: width * radius },
      svg("title", {}, seen === 2 ? name : `${name}, hidden`)));
  if (measured?.box) parts.push(box("measured", measured.box));
  if (measured?.centre) {
    const [u, v] = measured.centre;
    const arm = width * radius * 2;
    parts.push(svg("path", { class: "measured", d: `M${u - arm},${v}H${u + arm}M${u},${v - arm}V${v + arm}` }));
  }
  return svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "overlay", "aria-hidden": "true" }, ...parts);
};
