// What was clicked, kept by the browser where it keeps anything for a page; else leaving the page asks first.

const lost = new Set();
addEventListener("beforeunload", (e) => { if (lost.size) e.preventDefault(); });

// A list under a key. `again(list)`: another window of the same page changed it; null is none.
export function createKeep(key, again) {
  addEventListener("storage", (e) => { if (e.key === key) again(read()); });

  function read() {
    try {
      const value = JSON.parse(localStorage.getItem(key));
      return Array.isArray(value) ? value : null;
    } catch {
      return null;
    }
  }
  // Whether the browser keeps the list.
  function write(value) {
    lost.delete(key);
    try {
      if (value === null) localStorage.removeItem(key);
      else localStorage.setItem(key, JSON.stringify(value));
      return true;
    } catch {
      if (value !== null) lost.add(key);
      return false;
    }
  }
  return { read, write };
}
