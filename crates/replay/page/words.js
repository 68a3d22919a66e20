// Text of the page: elements, and names in words.

export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  const { dataset, ...rest } = properties;
  Object.assign(made, rest);
  if (dataset) Object.assign(made.dataset, dataset);
  made.append(...children);
  return made;
}

export const words = (name) => name.replaceAll("_", " ");
export const seconds = (steps, dt) => `${(steps * dt).toFixed(2)} s`;
