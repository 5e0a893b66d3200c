// What the API answers, under the names that the dashboard's comments refer to.
import type { components } from "./openapi";

type Schemas = components["schemas"];
export type Artifacts = Schemas["Artifacts"];
export type Assessment = Schemas["Assessment"];
export type Capture = Schemas["Capture"];
export type Captures = Schemas["Captures"];
export type Exports = Schemas["Exports"];
export type Job = Schemas["Job"];
export type JobError = Schemas["JobError"];
export type Jobs = Schemas["Jobs"];
export type LogPage = Schemas["LogPage"];
export type MadeShare = Schemas["MadeShare"];
export type Overlap = Schemas["Overlap"];
export type Problem = Schemas["Problem"];
export type Readiness = Schemas["Readiness"];
export type Running = Schemas["Running"];
export type Session = Schemas["Session"];
export type Share = Schemas["Share"];
export type Shares = Schemas["Shares"];
export type StageTime = Schemas["StageTime"];
export type ViewScore = Schemas["ViewScore"];
export type Worker = Schemas["Worker"];
export type Workers = Schemas["Workers"];
