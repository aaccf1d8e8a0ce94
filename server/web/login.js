// The form that asks for the token, in the place of the page. The address keeps the view meanwhile.
import { byId } from "./dom.js";
import { logIn, redeemCode } from "./session.js";
import { startTheme } from "./theme.js";

startTheme(() => {});
const form = byId("login"), token = byId("token"), button = byId("log-in"), message = byId("message");

async function attempt(run) {
  button.disabled = true;
  message.textContent = "";
  try {
    await run();
    location.reload();
  } catch (error) {
    message.textContent = error.message;
    button.disabled = false;
    token.focus();
    token.select();
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(() => logIn({ token: token.value.trim() }));
});
if (new URLSearchParams(location.hash.slice(1)).has("code")) {
  attempt(async () => {
    const why = await redeemCode();
    if (why) throw new Error(why);
  });
}
