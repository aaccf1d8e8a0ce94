// The login of the page: by a token, or by the code of `raynest open`; and its end.

/** Logs in by {token} or {code}; throws an Error that says what to do. Returns false if the user does not agree. */
export async function logIn(proof) {
  const answer = await fetch("/v1/login", { method: "POST", body: new URLSearchParams(proof) });
  if (answer.ok) return true;
  if (answer.status === 409) {
    const question = (await answer.text()).split(";")[0];
    // A link of somebody else would make what is loaded here theirs.
    return confirm(`${question}. Agree only if you made this address yourself, by raynest open.`) && logIn({ ...proof, agreed: "yes" });
  }
  const wait = answer.headers.get("Retry-After");
  throw new Error((await answer.text()).trim() + (wait ? `; try again in ${wait} s` : ""));
}

/** Ends the login, and the connections that it began. */
export const logOut = () => fetch("/v1/logout", { method: "POST" });

/** Returns {principal, role, login} as the daemon knows this page; null where it must log in. Throws while the daemon is away. */
export async function whoAmI() {
  const answer = await fetch("/v1/login");
  return answer.ok ? answer.json() : null;
}

/** Takes the code out of the address and logs in by it. Returns why that failed; "" if it did not. */
export async function redeemCode() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const code = parts.get("code");
  if (!code) return "";
  parts.delete("code");
  history.replaceState(null, "", `${location.pathname}${location.search}#${parts}`);
  try {
    await logIn({ code });
    return "";
  } catch (error) {
    return error.message;
  }
}
