// Who is looking: a token from the link, once, else from the form. The server keeps it as a cookie.

import { login } from "./api.js";

/** Take `#token=...` out of the address, so that it is neither kept in history nor shared on. */
export function takeLinkToken(location, history) {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token !== null) history.replaceState(null, "", location.pathname + location.search);
  return token;
}

export async function loginWithLink() {
  const token = takeLinkToken(window.location, window.history);
  if (token === null) return;
  try {
    await login(token);
  } catch (error) {
    await askForToken(error.message);
  }
}

/** Show the form until a token is accepted. */
export function askForToken(problem = "") {
  const dialog = document.getElementById("login");
  const form = document.getElementById("login-form");
  const field = document.getElementById("token");
  const words = document.getElementById("login-problem");
  words.textContent = problem;
  dialog.oncancel = (event) => event.preventDefault();
  if (!dialog.open) dialog.showModal();
  return new Promise((resolve) => {
    form.onsubmit = async (event) => {
      event.preventDefault();
      try {
        await login(field.value.trim());
      } catch (error) {
        words.textContent = error.message;
        return;
      }
      field.value = "";
      dialog.close();
      resolve();
    };
  });
}
