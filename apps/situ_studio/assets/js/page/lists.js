// The pages that list things (recordings, a dataset): menus of their rows, the theme, the search by its key.

import { Menu } from "./menu.js";
import { setTheme } from "./theme.js";
import { copy, toast } from "./toast.js";
import { sure as asked } from "./ask.js";
import { remember, showRecent } from "./recent.js";
import { tellTimes } from "./times.js";

const otherTheme = () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");

// The items of a row's menu come with the row (`Situ.Studio.Web.Dataset.Menu`).
function items(hook, row) {
  return JSON.parse(row.dataset.items).map((item) =>
    item === "-" ? item : { text: item.text, run: () => run(hook, item) },
  );
}

async function run(hook, { href, tab, copy: text, sure, event, value }) {
  if (href && tab) window.open(href);
  else if (href) location.assign(href);
  else if (text !== undefined) copy(text, "Copied");
  else if (!sure || (await asked(sure))) hook.pushEvent(event, value);
}

export const hooks = {
  Lists: {
    mounted() {
      this.menu = new Menu(document.body, (target) => {
        const row = target.closest("[data-items]");
        return row && items(this, row);
      });
      this.el.addEventListener("click", (e) => {
        if (e.target.closest("[data-act='theme']")) otherTheme();
        const dots = e.target.closest(".dots");
        if (!dots) return;
        const box = dots.getBoundingClientRect();
        this.menu.open(items(this, dots.closest("[data-items]")), box.left, box.bottom);
      });
      this.key = (e) => {
        if (e.target.closest?.("input, textarea, select, dialog") || e.ctrlKey || e.metaKey || e.altKey) return;
        if (e.key === "/") document.getElementById("search")?.focus();
        else if (e.key === "t") otherTheme();
        else return;
        e.preventDefault();
      };
      document.addEventListener("keydown", this.key);
      this.handleEvent("toast", ({ text }) => toast(text));
      if (this.el.id === "dataset") remember();
      const last = document.getElementById("recent");
      if (last) showRecent(last);
      this.handleEvent("go", ({ href }) => location.assign(href));
      tellTimes(this.el);
    },
    updated() {
      tellTimes(this.el);
    },
    destroyed() {
      document.removeEventListener("keydown", this.key);
      this.menu.destroy();
    },
  },
};
