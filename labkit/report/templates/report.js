for (const image of document.querySelectorAll("figure img")) {
  const save = document.createElement("a");
  save.className = "save";
  save.textContent = image.dataset.file.split(".").pop().toUpperCase();
  save.title = "save " + image.dataset.file;
  save.download = image.dataset.file;
  save.href = image.src;
  image.parentElement.append(save);
}
