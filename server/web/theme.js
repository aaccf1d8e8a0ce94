// Light or dark: as the system has it, until the switch says otherwise.
import { kept, keep } from "./settings.js";

export function startTheme(onChange) {
  const system = matchMedia("(prefers-color-scheme: dark)");
  const show = () => {
    const chosen = kept().theme;
    const dark = chosen ? chosen === "dark" : system.matches;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    onChange();
  };
  system.addEventListener("change", show);
  show();
  return () => {
    keep({ theme: document.documentElement.dataset.theme === "dark" ? "light" : "dark" });
    show();
  };
}
