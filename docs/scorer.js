// How the site's search ranks pages: user pages first, then theory, then measurements and internals. Pages and sections
// whose titles have the words of the question come before those that only mention them.
const LAST = /(-measured|consistency|against-runs|covariance-matrix|near-passes|recorded-approach|architecture|decisions|reliability|validation|gallery)$/;
const LATER = /^(theory|notebooks|contents)\//;
const NAMED = 12;
const asked = () => (localStorage.getItem("sphinx_highlight_terms") || "").split(" ").filter((word) => word.length > 2);
const named = (title) => {
  const words = asked(), text = title.toLowerCase();
  return (words.filter((word) => text.includes(word.replace(/s$/, ""))).length / Math.max(words.length, 2)) ** 2;
};
var Scorer = {
  score: ([page, title, anchor, description, score]) =>
    (score + NAMED * named(title)) * (LAST.test(page) ? 0.3 : LATER.test(page) ? 0.6 : 1),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
