// A link back to the page that was open before in this tab, or else to all recordings. The studio asks browsers to send
// no referrer, since the address of a page says what people look at, so the tab remembers its last page.

// The address to go back to: another page of this studio.
export function backAddress(before, here, base) {
  if (!before.startsWith(base)) return base;
  const bare = (url) => url.split(/[?#]/)[0];
  return bare(before) === bare(here) ? base : before;
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
