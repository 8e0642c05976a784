// Metres a unit of the model: known to the project, or from a distance that was typed in, which the address keeps.

const KEY = "metres_per_unit";

function ofAddress() {
  const value = Number(new URLSearchParams(location.hash.slice(1)).get(KEY));
  return Number.isFinite(value) && value > 0 ? value : null;
}

function intoAddress(scale) {
  const entries = new URLSearchParams(location.hash.slice(1));
  if (scale) entries.set(KEY, String(Number(scale.toPrecision(8))));
  else entries.delete(KEY);
  const text = entries.toString().replace(/=(?=&|$)/g, "");
  history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
}

export function createScale(metric) {
  let scale = metric ? 1 : ofAddress();
  // A link to a section of the page takes the place of what the address held.
  addEventListener("hashchange", () => { if (!metric && scale && !ofAddress()) intoAddress(scale); });
  return {
    metric,
    get value() { return scale; },
    set(metres, units) {
      scale = metres / units;
      intoAddress(scale);
    },
    forget() {
      scale = null;
      intoAddress(null);
    },
  };
}
