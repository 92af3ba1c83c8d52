// Requests to the server: JSON there and back, errors as one sentence.

import { who } from "./settings.js";
/** @import { Answers, Imported, Params, Posted } from "./types.js" */

const TIMEOUT_MS = 20000;
const SEND_MS = 600000;

/** A request that failed. `status` 0: the server was not reached. */
export class ApiError extends Error {
  constructor(/** @type {number} */ status, /** @type {string} */ message) {
    super(message);
    this.name = "ApiError";
    this.status = status;
  }
}

/** What to give to `catch` of a request: an ApiError goes to `handle`, any other fault goes on.
 * @template [T=undefined] @param {(error: ApiError) => T} [handle]
 */
export function onFailure(handle) {
  return (/** @type {unknown} */ error) => {
    if (!(error instanceof ApiError)) throw error;
    return handle?.(error);
  };
}

/** The address of an API path with `who` and its parameters. */
export function address(/** @type {string} */ path, /** @type {Params} */ params = {}) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries({ who: who() || null, ...params })) {
    for (const one of [value].flat()) if ((one ?? null) !== null) query.append(name, String(one));
  }
  return `${path}?${query}`;
}

/** GET a path; throws ApiError. @template {keyof Answers} P @returns {Promise<Answers[P]>} */
export async function get(/** @type {P} */ path, /** @type {Params} */ params = {}) {
  return request(address(path, params));
}

/** POST a body to a path; `who` is filled in where the body has none. Throws ApiError.
 * @template {keyof Posted} P @returns {Promise<Posted[P]>}
 */
export async function post(/** @type {P} */ path, /** @type {object} */ body) {
  return request(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ who: who(), ...body }),
  });
}

/** POST a file of labels to a path; throws ApiError.
 * @param {string} path @param {Params} params @param {File} file @returns {Promise<Imported>}
 */
export async function send(path, params, file) {
  const headers = { "Content-Type": "application/octet-stream" };
  return request(address(path, params), { method: "POST", headers, body: file }, SEND_MS);
}

/** Fetch an address as it is, in `most` ms at most: a successful Response. Throws ApiError.
 * @param {string} url @param {RequestInit} [options] @param {number} [most]
 */
export async function fetchOk(url, options = {}, most = TIMEOUT_MS) {
  const timeout = AbortSignal.timeout(most);
  const signal = options.signal ? AbortSignal.any([options.signal, timeout]) : timeout;
  let response;
  try {
    response = await fetch(url, { credentials: "same-origin", ...options, signal });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new ApiError(0, "the server does not answer");
  }
  if (!response.ok) throw new ApiError(response.status, await sentence(response));
  return response;
}

/** @param {string} url @param {RequestInit} [options] @param {number} [most] */
async function request(url, options, most) {
  const response = await fetchOk(url, options, most);
  try {
    return await response.json();
  } catch {
    throw new ApiError(0, "the server's answer broke off");
  }
}

/** @param {Response} response @returns {Promise<string>} */
async function sentence(response) {
  try {
    const { error } = await response.json();
    if (error) return error;
  } catch {
    // Not ours: a proxy's page, or cut off. The status says what there is to say.
  }
  return `the server answered ${response.status} ${response.statusText}`.trim();
}
