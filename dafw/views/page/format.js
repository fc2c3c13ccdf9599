// Numbers as people read them, and round numbers for axes.

const RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** Return a number with about three digits; a dash for a missing one. */
export function formatNumber(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size >= 1e5 || size < 1e-3) {
    const [front, power] = value.toExponential(Math.max(0, digits - 2)).split("e");
    return `${minus(strip(front))}×10${raised(Number(power))}`;
  }
  const text = size >= 100 ? value.toFixed(0) : value.toPrecision(digits);
  return minus(strip(text));
}

/** Return a number with its units: "12.3 %", "270°", "5 m s⁻¹". */
export function withUnits(value, units) {
  const text = formatNumber(value);
  if (!units || text === "–") return text;
  return units === "°" ? `${text}°` : `${text}\u202f${units}`;
}

/** Return round numbers between two values, about `count` of them. */
export function roundTicks(low, high, count) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    ticks.push(Number((k * step).toPrecision(12)));
  }
  return ticks;
}

/** Return powers of ten between two positive values, at most about `count` of them. */
export function powerTicks(low, high, count) {
  const first = Math.ceil(Math.log10(low) - 1e-9);
  const last = Math.floor(Math.log10(high) + 1e-9);
  const every = Math.max(1, Math.ceil((last - first + 1) / count));
  const ticks = [];
  for (let power = first; power <= last; power += every) ticks.push(10 ** power);
  return ticks;
}

/** Return a round number with up to six digits, as axes and times have it. */
export function tickLabel(value) {
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) {
    const [front, power] = value.toExponential(2).split("e");
    const factor = minus(strip(front));
    return factor === "1" ? `10${raised(Number(power))}` : `${factor}×10${raised(Number(power))}`;
  }
  return minus(String(Number(value.toPrecision(6))));
}

function strip(text) {
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

function minus(text) {
  return text.replace("-", "−");
}

function raised(power) {
  const digits = [...String(Math.abs(power))].map((digit) => RAISED[Number(digit)]).join("");
  return power < 0 ? `⁻${digits}` : digits;
}
