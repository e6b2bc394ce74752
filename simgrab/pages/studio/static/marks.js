// What a frame's truth has beyond labels: C′, G′ and the angles, in px of the image. CSS switches which of them show.

import { svg } from "./dom.js";
import { overlay } from "./overlay.js";

const line = (kind, [u0, v0], [u1, v1]) => svg("line", { class: kind, x1: u0, y1: v0, x2: u1, y2: v1 });

const text = (unit, [u, v], [du, dv], words) => svg("text", { class: "angles", x: u + du * unit, y: v + dv * unit + 0.7 * unit,
  "font-size": 2 * unit, "text-anchor": du < 0 ? "end" : "start" }, words);

const middle = ([u0, v0], [u1, v1]) => [(u0 + u1) / 2, (v0 + v1) / 2];

const degrees = (value) => `${value.toFixed(1).replace("-", "−")}°`;

/** The arc of θ about C′, clockwise from G′ to the grab centre. */
const arc = (principal, vertical, centre, radius) => {
  const angle = (point) => Math.atan2(point[1] - principal[1], point[0] - principal[0]);
  const on = (turn) => [principal[0] + radius * Math.cos(turn), principal[1] + radius * Math.sin(turn)];
  const from = angle(vertical);
  const turn = ((angle(centre) - from + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
  const [u0, v0] = on(from);
  const [u1, v1] = on(from + turn);
  return svg("path", { class: "angles", d: `M${u0},${v0}A${radius},${radius} 0 0 ${turn > 0 ? 1 : 0} ${u1},${v1}` });
};

/** Make the drawing of a frame. */
export const marked = (about, measured) => {
  const { width, truth, values } = about;
  const { principal, vertical, centre } = truth;
  const unit = width / 100;
  const drawn = overlay({ ...about, measured: measured ?? undefined }, 0.006);
  const parts = [];
  if (principal && vertical) {
    parts.push(line("angles", principal, vertical));
    if (centre && values.present) {
      parts.push(line("angles", principal, centre), line("angles swing", vertical, centre));
      parts.push(arc(principal, vertical, centre, 3.5 * unit));
      const side = centre[0] < vertical[0] ? -1 : 1;
      const up = principal[1] < vertical[1] ? -1 : 1;
      parts.push(text(unit, centre, [1.6 * side, 0], `α ${degrees(values.alpha_deg)}`));
      parts.push(text(unit, middle(principal, vertical), [-1.2 * side, 0], `β ${degrees(values.beta_deg)}`));
      if (values.theta_deg !== null) parts.push(text(unit, principal, [1.2 * side, 1.6 * up], `θ ${degrees(values.theta_deg)}`));
    }
  }
  if (principal) {
    const [u, v] = principal;
    const arm = 1.2 * unit;
    parts.push(svg("path", { class: "principal", d: `M${u - arm},${v}H${u + arm}M${u},${v - arm}V${v + arm}` },
      svg("title", {}, "C′, the principal point")));
  }
  if (vertical)
    parts.push(svg("circle", { class: "vertical", cx: vertical[0], cy: vertical[1], r: 0.9 * unit }, svg("title", {}, "G′, the image of the vertical")));
  drawn.append(...parts);
  return drawn;
};
