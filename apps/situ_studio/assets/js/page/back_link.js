// A link back to the previous page in this tab, or else to the list of recordings. The studio tells browsers not to
// send a referrer, since addresses reveal what people look at, so the tab remembers its last page.

// Returns the address to go back to: another page of this studio.
export function backAddress(before, here, base) {
  if (!before.startsWith(base)) return base;
  const stripQuery = (url) => url.split(/[?#]/)[0];
  return stripQuery(before) === stripQuery(here) ? base : before;
}

const KEY = "situ-page";

globalThis.addEventListener?.("pagehide", () => {
  if (!document.getElementById("settings-back")) sessionStorage.setItem(KEY, location.href);
});

export const hooks = {
  Back: {
    mounted() {
      this.el.href = backAddress(sessionStorage.getItem(KEY) ?? "", location.href, document.baseURI);
    },
  },
};
