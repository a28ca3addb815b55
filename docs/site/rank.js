// node rank.js SITE QUERY...: the location of the first result of each query, as JSON, by the search of a built site.
const fs = require("fs"), path = require("path"), vm = require("vm");
const [site, ...queries] = process.argv.slice(2);
const workers = path.join(site, "assets/javascripts/workers");
const file = fs.readdirSync(workers).find((name) => /^search\..*\.js$/.test(name));
const listeners = [], answers = [];
const worker = {
  console, setTimeout, clearTimeout, URL, performance,
  location: { href: "http://localhost/assets/javascripts/workers/" + file },
  importScripts() {},
  postMessage(message) { answers.push(message); },
  addEventListener(type, listener) { if (type === "message") listeners.push(listener); },
};
worker.self = worker.globalThis = worker.window = worker;
vm.runInNewContext(fs.readFileSync(path.join(workers, file), "utf8"), worker);

const SETUP = 0, QUERY = 2, RESULT = 3; // kinds of messages
async function ask(type, data) {
  answers.length = 0;
  for (const listener of listeners) await listener({ data: { type, data } });
  return answers.find((message) => message.type === RESULT);
}

(async () => {
  const built = JSON.parse(fs.readFileSync(path.join(site, "search/search_index.json"), "utf8"));
  await ask(SETUP, { config: built.config, docs: built.docs, options: { suggest: true } });
  const first = [];
  for (const query of queries) {
    const answer = await ask(QUERY, query);
    const page = answer && answer.data.items[0]; // the sections of one page
    first.push(page ? page.slice().sort((a, b) => b.score - a.score)[0].location : null);
  }
  console.log(JSON.stringify(first));
})();
