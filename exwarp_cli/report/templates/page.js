"use strict";
// The choice of theme: what the system says, light, or dark.
(() => {
  const order = ["automatic", "light", "dark"];
  const button = document.getElementById("theme");
  let theme = "automatic";
  const apply = () => {
    if (theme === "automatic") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
    button.textContent = `Theme: ${theme}`;
  };
  // Pages opened as files may have no storage.
  try { theme = order.includes(localStorage.exwarpTheme) ? localStorage.exwarpTheme : theme; } catch {}
  button.addEventListener("click", () => {
    theme = order[(order.indexOf(theme) + 1) % order.length];
    try { localStorage.exwarpTheme = theme; } catch {}
    apply();
  });
  button.hidden = false;
  apply();
})();
