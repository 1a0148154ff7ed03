// Numbers with their units, as people write them.

const RAISED = {"-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹"};
const AU_M = 1.495978707e11;

export const isNumber = value => typeof value === "number" && Number.isFinite(value);

/** Some significant digits; powers of ten beyond 1e5 and below 1e-3. */
export function digits(value, n = 4) {
  if (!isNumber(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-3 && size < 1e6) {
    const decimals = Math.max(0, n - 1 - Math.floor(Math.log10(size)));
    return value.toFixed(Math.min(decimals, 8)).replace("-", "−");
  }
  const [mantissa, exponent] = value.toExponential(n - 1).split("e");
  return `${mantissa.replace("-", "−")} × 10${[...String(+exponent)].map(sign => RAISED[sign]).join("")}`;
}

export const percent = (share, n = 2) => isNumber(share) ? `${digits(100 * share, n)} %` : "–";

export const degrees = value => isNumber(value) ? `${value.toFixed(2).replace("-", "−")}°` : "–";

export function length(m) {
  if (!isNumber(m)) return ["–", ""];
  if (m >= 0.1 * AU_M) return [digits(m / AU_M, 6), "au"];
  if (m >= 1e4) return [grouped((m / 1e3).toFixed(m >= 1e6 ? 1 : 3)), "km"];
  return [m.toFixed(3), "m"];
}

/** Thousands apart, by a thin space. */
export function grouped(text) {
  const [whole, part] = String(text).split(".");
  const apart = whole.replace(/\B(?=(\d{3})+(?!\d))/g, "\u2009");
  return part === undefined ? apart : `${apart}.${part}`;
}

export function duration(s) {
  const at = Math.floor(s);
  const two = value => String(value).padStart(2, "0");
  return `${Math.floor(at / 3600)}:${two(Math.floor(at / 60) % 60)}:${two(at % 60)}`;
}

export const unitText = unit => unit === "W/m2" ? "W/m²" : unit;
