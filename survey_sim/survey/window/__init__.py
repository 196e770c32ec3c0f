"""The simulator as an application in the browser (Goodwin et al. 2014, Figure 14): `survey-sim view --serve`.

`jobs` does what the window asks for, one job at a time; `app` is the web application around it; `window.html`, `window.css`
and `window.js` are its page, which shows results in the field player. Needs the extra `serve`.
"""
