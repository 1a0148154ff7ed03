// The columns of numbers beside the frame.

import {degrees, digits, duration, grouped, isNumber, length, percent, unitText} from "./numbers.js";

const NAMES = {coverage: "area coverage", rays: "rays", raster: "OpenGL", cycles: "Cycles"};

/** Fill a list with rows [name, value, unit, class]; rows that stand there are kept, so that nothing flickers. */
export function fill(list, rows) {
  const known = rows.filter(Boolean);
  while (list.children.length > 2 * known.length) list.lastChild.remove();
  known.forEach(([name, value, unit = "", kind = ""], k) => {
    if (!list.children[2 * k]) list.append(document.createElement("dt"), document.createElement("dd"));
    const term = list.children[2 * k], told = list.children[2 * k + 1];
    set(term, name);
    const text = `${value}\u0000${unit}\u0000${kind}`;
    if (told.dataset.text === text) return;
    told.dataset.text = text;
    told.className = kind;
    told.textContent = value;
    if (unit) {
      const small = document.createElement("span");
      small.className = "unit";
      small.textContent = unit;
      told.append(small);
    }
  });
}

export const set = (element, text) => { if (element.textContent !== text) element.textContent = text; };

export function frameRows(head) {
  const n_pixels = head.width * head.height, total = head.timings_ms?.total;
  return [
    ["client", head.stream[0]],
    ["camera", head.stream[1]],
    ["size", `${head.width} × ${head.height}`, "px"],
    ["time", grouped(Number((head.t_s ?? 0).toPrecision(10))), "s"],
    head.output === "dn" && ["exposure", digits(1e3 * head.exposure_s), "ms"],
    head.output === "dn" && ["saturated", head.n_saturated_px ? percent(head.n_saturated_px / n_pixels) : "none", "",
                             head.n_saturated_px ? "saturated" : ""],
    ["drawn in", digits(total, 3), "ms"],
  ];
}

export function planRows(plan) {
  if (!plan) return [];
  const isOver = plan.missed?.length > 0;
  const rows = [
    ["predicted error", percent(plan.predicted_error), "", isOver ? "over" : ""],
    ["allowed", percent(plan.max_error)],
  ];
  for (const window of plan.windows ?? []) {
    rows.push([window.bodies?.join(", ") || "sky", NAMES[window.engine] ?? window.engine]);
    rows.push(["samples", samples(window)]);
    if (window.bodies?.length && window.engine !== "raster") {
      rows.push(["shadows", window.by_centroids ? "whole facets, by centroid" : "clipped at their edges"]);
    }
  }
  for (const body of plan.bodies ?? []) {
    if (body.is_visible) rows.push([`${body.name} across`, digits(body.size_px, 3), "px"]);
    if (body.is_visible && body.shadow_map_px) rows.push(["shadow map", String(body.shadow_map_px), "px"]);
  }
  return rows;
}

function samples(window) {
  if (window.engine === "coverage") return "none: exact areas";
  const first = window.samples ? `${window.samples}² a pixel` : "a grid of its own";
  return window.refined_share > 0 ? `${first}, ${window.refined_samples}² in ${percent(window.refined_share)}` : first;
}

/** Sentences: what each stage did, what was not needed, and what was left out. */
export function stageRows(head) {
  const rows = [], notNeeded = [];
  for (const text of head.plan?.left_out ?? []) rows.push(["left out", text]);
  for (const [key, text] of Object.entries(head.stages ?? {})) {
    const name = key.replaceAll("_", " ");
    if (text.startsWith("skipped")) notNeeded.push(name);
    else rows.push([name, text]);
  }
  if (notNeeded.length) rows.push(["not needed here", notNeeded.join(", ")]);
  return rows;
}

export function geometryRows(g) {
  return [
    ["range", ...length(g.range_m)],
    ["phase angle", degrees(g.phase_deg)],
    ["off boresight", degrees(g.off_boresight_deg)],
    ["field of view", degrees(g.fov_deg)],
    ["Sun", digits(g.sun_distance_au, 5), "au"],
  ];
}

export function pixelRows(head, value, asked) {
  const unit = unitText(head.unit), detector = head.camera.detector;
  const rows = [[head.output === "dn" ? "signal" : "irradiance",
                 head.output === "dn" ? String(value ?? "–") : digits(value, 6), unit]];
  if (head.output === "dn" && detector && value !== undefined) {
    rows.push(["electrons", grouped(Math.round((value - detector.offset_DN) / detector.gain_DN_per_electron))
      .replace("-", "−"), "e⁻"]);
    rows.push(["irradiance", digits(asked?.irradiance_W_m2, 6), "W/m²"]);
  }
  rows.push(["body", asked ? asked.body ?? "sky" : "–"]);
  rows.push(["range", ...length(asked?.range_m)]);
  for (const name of ["incidence", "emission", "phase"]) rows.push([name, degrees(asked?.[`${name}_deg`])]);
  return rows;
}

export function serverRows({status, streams, seen, endpoint, viewers, not_shown}) {
  if (!("uptime_s" in status)) return [["address", endpoint, "", "long"]];
  const errors = Object.entries(status.errors).map(([code, n]) => `${n} ${code}`).join(", ");
  const workers = status.workers;
  return [
    ["address", endpoint],
    ["up", duration(status.uptime_s)],
    ["renders", grouped(status.requests.render ?? 0)],
    ["errors", errors || "none", "", errors ? "over" : ""],
    ["clients", String(status.clients)],
    workers && ["workers", `${workers.ready} of ${workers.of} ready`, "", workers.ready < workers.of ? "over" : ""],
    workers && workers.restarts > 0 && ["restarts", String(workers.restarts), "", "over"],
    ["streams", String(streams.length)],
    ["over budget", seen.frames ? `${seen.over_budget} of ${grouped(seen.frames)} seen` : "–", "",
     seen.over_budget ? "over" : ""],
    not_shown && ["not shown", not_shown, "", "long"],
    ["pages open", String(viewers)],
    ["drawn by", `${status.gl_renderer ?? ""}`.replace(/\s*\(.*$/, "") + (status.backend ? `, ${status.backend}` : "")],
  ];
}

export function strip(renders, waiting) {
  const ms = value => isNumber(value) ? `${digits(value, 3)} ms` : "–";
  return {rate: isNumber(renders?.per_second) ? renders.per_second.toFixed(1) : "–", p50: ms(renders?.p50_ms),
          p95: ms(renders?.p95_ms), p99: ms(renders?.p99_ms), waiting: String(waiting ?? "–")};
}
