/* The window: sends the form, asks how far the job is, shows the player. */
"use strict";

const $ = (id) => document.getElementById(id);
const POLL_MS = 300;

function showFields() {
  const source = $("source").value, isUpload = !$("offered") || $("offered").value === "";
  for (const item of document.querySelectorAll("[data-for]")) {
    const words = item.dataset.for.split(" ");
    item.hidden = !(words.includes(source) || (words.includes("upload") && isUpload));
    for (const field of item.matches("input, select") ? [item] : item.querySelectorAll("input, select")) field.disabled = item.hidden;
  }
  $("files").multiple = source !== "targets";
  const asFiles = $("instrument").options[0];
  asFiles.disabled = source === "targets";
  if (source === "targets" && !$("instrument").value) $("instrument").value = document.querySelector("[data-default]").value;
  else if (source !== "targets" && !$("instrument").dataset.chosen) $("instrument").value = "";
}

function show({ status = "", error = "", findings = [], job = null }) {
  $("status").textContent = status;
  $("error").textContent = error; $("error").hidden = !error;
  $("findings").replaceChildren(...findings.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  $("findings").hidden = !findings.length;
  $("links").hidden = job === null;
  if (job === null) return;
  $("open").href = `/jobs/${job}/player`; $("zip").href = `/jobs/${job}/run.zip`;
}

function showPlayer(job) {
  $("player").src = `/jobs/${job}/player#path=${$("path").value}`;
  $("player").hidden = false; $("empty").hidden = true;
}

/* What the button does: run, or cancel the job that is at work. */
function showBusy(job) {
  $("run").hidden = job !== null;
  $("cancel").hidden = job === null;
  $("cancel").disabled = false;
  $("cancel").onclick = () => { $("cancel").disabled = true; fetch(`/jobs/${job}/cancel`, { method: "POST" }); };
}

async function run(event) {
  event.preventDefault();
  $("run").disabled = true;
  show({ status: "sending files" });
  try {
    const sent = await fetch("/jobs", { method: "POST", body: new FormData($("form")) });
    let report = await sent.json();
    if (sent.ok) showBusy(report.job);
    while (sent.ok && ["waiting", "running"].includes(report.state)) {
      show({ status: report.stage });
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      report = await (await fetch(`/jobs/${report.job}`)).json();
    }
    if (report.error) show({ error: report.error });
    else if (report.state === "cancelled") show({ status: "cancelled" });
    else {
      show({ status: report.findings.length ? `${report.findings.length} findings` : "done: no collision", findings: report.findings, job: report.job });
      showPlayer(report.job);
    }
  } catch (fault) {
    show({ error: `the simulator does not answer (${fault.message})` });
  } finally {
    $("run").disabled = false;
    showBusy(null);
  }
}

$("form").addEventListener("submit", run);
$("source").addEventListener("change", showFields);
if ($("offered")) $("offered").addEventListener("change", showFields);
$("instrument").addEventListener("change", () => { $("instrument").dataset.chosen = "1"; });
showFields();
