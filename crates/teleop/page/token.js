// The token of the page's address. It leaves the address bar at once, so that no shared screen and no bookmark shows it, and stays with
// this tab, so that a page can be loaded again.

const NAME = "fiatlux-token";

export function takeToken() {
  const given = new URLSearchParams(location.search).get("token");
  // A browser that keeps nothing for a tab keeps the address: else the page could not be loaded again.
  try {
    if (given && remember(given)) history.replaceState(null, "", location.pathname);
  } catch {
    // Browsers may refuse it: then the token stays where it was.
  }
  return given ?? "";
}

function remember(token) {
  try {
    sessionStorage.setItem(NAME, token);
    return sessionStorage.getItem(NAME) === token;
  } catch {
    return false;
  }
}

// The token that this tab had.
export function rememberedToken() {
  try {
    return sessionStorage.getItem(NAME);
  } catch {
    return null;
  }
}
