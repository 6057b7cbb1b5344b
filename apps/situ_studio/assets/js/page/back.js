// A link back to the page that was open before in this tab; without one, to all recordings. Browsers are told to send
// no referrer, as addresses of pages say what people look at.

// The address to go back to: one of this studio's own pages, and not the page itself.
export function backTo(before, here, base) {
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
      this.el.href = backTo(sessionStorage.getItem(KEY) ?? "", location.href, document.baseURI);
    },
  },
};
