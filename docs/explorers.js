// An explorer is loaded when its heading is opened.
document.querySelectorAll("details iframe[data-src]").forEach((frame) => {
  frame.closest("details").addEventListener("toggle", () => { frame.src ||= frame.dataset.src; });
});
