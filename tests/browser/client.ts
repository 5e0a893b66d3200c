// A program that knows the API from openapi.yaml alone. It is compiled and not run: a description
// that leaves too much open, or says what does not fit, fails here.
import createClient from "openapi-fetch";
import type { components, paths } from "./openapi";

type Job = components["schemas"]["Job"];
type Problem = components["schemas"]["Problem"];

/** Makes a scene of finished uploads, and a video and a link of it. */
export async function reconstruct(server: string, token: string, uploads: string[]) {
  const fled = createClient<paths>({ baseUrl: server, headers: { Authorization: `Bearer ${token}` } });
  const made = await fled.POST("/v1/jobs", {
    params: { header: { "Idempotency-Key": uploads.join(" ") } },
    body: { uploads, preset: "preview", options: { rounds: 2 } },
  });
  const path = { id: done(made).id };
  await fled.PATCH("/v1/jobs/{id}", { params: { path }, body: { name: "hall" } });
  let job = await jobOf(path.id);
  while (job.state === "queued" || job.state === "running") job = await jobOf(path.id);
  if (job.error) throw new Error(`${job.error.detail} ${job.error.hint}`);

  const rounds = done(await fled.GET("/v1/jobs/{id}/rounds", { params: { path } }));
  // Another answer of this address is a table.
  if (typeof rounds === "string") throw new Error("not asked for");
  const best = rounds.rounds.find(({ round }) => round === rounds.best_round);
  const views = best?.views?.filter(({ is_shaken }) => is_shaken).map(({ name }) => name);
  const gains = best?.records.map(({ image, psnr_cc_db }): [string, number] => [image, psnr_cc_db]);

  const video = done(await fled.POST("/v1/jobs/{id}/videos", { params: { path }, body: { kind: "orbit", seconds: 4 } }));
  const link = done(await fled.POST("/v1/jobs/{id}/shares", { params: { path }, body: { days: 7 } }));
  const scene = await fled.GET("/v1/jobs/{id}/artifacts/{name}", {
    params: { path: { ...path, name: "scene.ply" } },
    parseAs: "stream",
  });
  return { score: job.score?.psnr_cc_db, views, gains, video: video.id, link: server + link.path, scene: scene.data };

  async function jobOf(id: string): Promise<Job> {
    return done(await fled.GET("/v1/jobs/{id}", { params: { path: { id } } }));
  }
}

/** All jobs of one's own, page by page. */
export async function* jobs(server: string): AsyncGenerator<Job> {
  const fled = createClient<paths>({ baseUrl: server });
  let cursor: string | undefined;
  do {
    const page = done(await fled.GET("/v1/jobs", { params: { query: { cursor, state: "succeeded" } } }));
    yield* page.jobs;
    cursor = page.next_cursor ?? undefined;
  } while (cursor);
}

function done<T>({ data, error }: { data?: T; error?: Problem }): T {
  if (data === undefined) throw new Error(`${error?.code}: ${error?.detail} ${error?.hint ?? ""}`);
  return data;
}

export async function mistakes(server: string) {
  const fled = createClient<paths>({ baseUrl: server });
  // @ts-expect-error There is no such address.
  await fled.GET("/v1/scenes");
  // @ts-expect-error The address needs an ID.
  await fled.DELETE("/v1/jobs/{id}", {});
  // @ts-expect-error A priority is a number.
  await fled.PUT("/v1/jobs/{id}/priority", { params: { path: { id: "" } }, body: { priority: "high" } });
  // @ts-expect-error A job is in no such state.
  await fled.GET("/v1/jobs", { params: { query: { state: "done" } } });
}
