// Shown to whoever does not have the token. A tab that had it asks again with it, once: a program that was started again has another.

import { rememberedToken } from "./token.js";

const token = rememberedToken();
if (token && !new URLSearchParams(location.search).has("token")) location.replace(`/?token=${encodeURIComponent(token)}`);
