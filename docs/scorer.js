// How the site's search ranks pages: user pages first, then theory, then measurements and internals.
const LAST = /(-measured|consistency|against-runs|covariance-matrix|near-passes|recorded-approach|architecture|decisions|reliability|validation)$/;
const LATER = /^(theory|notebooks|contents)\/|^gallery$/;
var Scorer = {
  score: ([page, title, anchor, description, score]) =>
    score * (LAST.test(page) ? 0.3 : LATER.test(page) ? 0.6 : 1),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
