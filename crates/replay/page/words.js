// Text of the page: elements, and names in words.

export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  const { dataset, ariaLabel, ...rest } = properties;
  Object.assign(made, rest);
  // Firefox has the property only since 119.
  if (ariaLabel) made.setAttribute("aria-label", ariaLabel);
  if (dataset) Object.assign(made.dataset, dataset);
  made.append(...children);
  return made;
}

export const words = (name) => name.replaceAll("_", " ");
export const seconds = (steps, dt) => `${(steps * dt).toFixed(2)} s`;
