// Embeddings that the reader keeps under a name, in the browser's storage.

const PLACE = "ear explore";

export function makeKeeping(robot) {
  let kept = read() ?? {};
  function read() {  // null where the browser stores nothing
    try { return JSON.parse(localStorage.getItem(PLACE)); } catch { return null; }
  }
  return {
    all: () => Object.entries(kept[robot] || {}).map(([name, lte]) => ({ name, lte })),
    change(name, lte) {  // null forgets it
      kept = read() ?? kept;  // with what another page has kept meanwhile
      const { [name]: _, ...others } = kept[robot] || {};
      kept[robot] = lte ? { ...others, [name]: lte } : others;
      try { localStorage.setItem(PLACE, JSON.stringify(kept)); } catch { /* kept until the page is left */ }
    },
  };
}

export const words = (code) => `--lte ${code.map((part) => part.toFixed(4)).join(" ")}`;

// Copies a text; a page from a file may not be allowed to use the clipboard, but may copy what is selected.
export async function copy(text, element) {
  try { await navigator.clipboard.writeText(text); return true; } catch { /* the older way follows */ }
  const range = document.createRange();
  range.selectNodeContents(element);
  getSelection().removeAllRanges();
  getSelection().addRange(range);
  return document.execCommand("copy");
}
