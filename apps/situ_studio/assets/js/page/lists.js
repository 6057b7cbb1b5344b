// The pages with lists (recordings, a dataset): context menus of rows, theme, and the search key.

import { Menu } from "./menu.js";
import { setTheme } from "./theme.js";
import { copyText, showToast } from "./toast.js";
import { confirmAction as asked } from "./questions.js";
import { rememberPage, showRecent } from "./recent.js";
import { recallSession, withView } from "./sessions.js";
import { showTimes } from "./times.js";

const toggleTheme = () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");

// Returns the menu items of a row, which come with it (`Situ.Studio.Web.Dataset.RowMenu`).
function rowItems(hook, row) {
  return JSON.parse(row.dataset.items).map((item) =>
    item === "-" ? item : { text: item.text, run: () => runItem(hook, item) },
  );
}

async function runItem(hook, { href, tab, copy: text, sure, event, value }) {
  if (href && tab) window.open(href);
  else if (href) location.assign(href);
  else if (text !== undefined) copyText(text, "Copied");
  else if (!sure || (await asked(sure))) hook.pushEvent(event, value);
}

export const hooks = {
  Lists: {
    mounted() {
      this.menu = new Menu(document.body, (target) => {
        const row = target.closest("[data-items]");
        return row && rowItems(this, row);
      });
      this.el.addEventListener("click", (e) => {
        if (e.target.closest("[data-act='theme']")) toggleTheme();
        this.keepView(e);
        const dots = e.target.closest(".dots");
        if (!dots) return;
        const box = dots.getBoundingClientRect();
        this.menu.open(rowItems(this, dots.closest("[data-items]")), box.left, box.bottom);
      });
      this.key = (e) => {
        if (e.target.closest?.("input, textarea, select, dialog") || e.ctrlKey || e.metaKey || e.altKey) return;
        if (e.key === "/") document.getElementById("search")?.focus();
        else if (e.key === "t") toggleTheme();
        else return;
        e.preventDefault();
      };
      document.addEventListener("keydown", this.key);
      this.handleEvent("toast", ({ text }) => showToast(text));
      if (this.el.id === "dataset") rememberPage();
      const last = document.getElementById("recent");
      if (last) showRecent(last);
      this.handleEvent("go", ({ href }) => location.assign(href));
      showTimes(this.el);
    },
    // A session opens with the view of the session that this tab showed last.
    keepView(e) {
      const link = e.target.closest(".node.session a.add");
      if (!link || e.ctrlKey || e.metaKey || e.shiftKey) return;
      e.preventDefault();
      location.assign(withView(link.getAttribute("href"), recallSession(this.el.dataset.id)));
    },
    updated() {
      showTimes(this.el);
    },
    destroyed() {
      document.removeEventListener("keydown", this.key);
      this.menu.destroy();
    },
  },
};
