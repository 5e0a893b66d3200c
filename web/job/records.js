// The records of a round that compare with those of others.

/** Whether the capture has ground truth; only that measures quality. */
export const hasTruth = (rounds) => rounds.some((round) => round.records.some(({ reference }) => reference === "gt"));

/** The references that make rounds comparable, at the run's target brightness. */
const REFERENCE = { true: "gt", false: "enhanced" };

/** The score that compares rounds, dB; `undefined` in older reports, which had an SSIM. */
export const agreement = ({ score }) => (score > 1 ? score : undefined);

/** A round's comparable scores of one kind of picture; `undefined` if there are none. */
export const recordOf = ({ records }, { image, split }, isTruth) => records.find((record) =>
  record.image === image && record.split === split && record.brightness === "final" && record.reference === REFERENCE[isTruth]);
