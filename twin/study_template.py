"""The page of a study's report; jinja2 escapes every value put into it."""

from __future__ import annotations

PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 74rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { margin-bottom: .2rem; } h2 { margin-top: 2.4rem; border-bottom: 1px solid #ddd; }
p.lead { font-size: 1.1rem; max-width: 60rem; }
.note { color: #555; max-width: 60rem; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; }
th, td { text-align: left; padding: .22rem .6rem; border-bottom: 1px solid #e4e4e4;
  vertical-align: top; }
th { background: #f4f6f8; position: sticky; top: 0; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.sure { font-weight: 600; } td.which { min-width: 18rem; }
.scroll { overflow: auto; max-height: 34rem; border: 1px solid #eee; }
figure { display: inline-block; margin: .8rem 1rem .8rem 0; vertical-align: top; width: 34rem;
  max-width: 100%; }
figure img { width: 100%; } figcaption { font-size: .9rem; color: #333; }
details > summary { cursor: pointer; color: #0b5394; margin: .6rem 0; }
code { background: #f4f6f8; padding: 0 .2rem; }
.ok { color: #176b2c; } .bad { color: #a61b1b; }
</style>
</head>
<body>
<h1>{{ title }}</h1>
<p class="note">{{ facts }}</p>
{% for paragraph in story %}<p class="lead">{{ paragraph }}</p>{% endfor %}

<h2>How the runs ended</h2>
<table>
<tr><th>ended</th><th>runs</th><th>meaning</th></tr>
{% for status, n, meaning in statuses %}
<tr><td class="{{ 'ok' if status == 'ok' else 'bad' }}">{{ status }}</td>
<td class="n">{{ n }}</td><td>{{ meaning }}</td></tr>
{% endfor %}
</table>
{% if failures %}
<details><summary>the {{ failures|length }} first runs without success, and why</summary>
<div class="scroll"><table>
<tr><th>run</th><th>which</th><th>replication</th><th>seed</th><th>ended</th><th>why</th>
<th>log</th></tr>
{% for row in failures %}
<tr><td><code>{{ row.run }}</code></td><td>{{ row.cell }}</td>
<td class="n">{{ row.replication }}</td>
<td class="n">{{ row.seed }}</td><td>{{ row.status }}</td><td>{{ row.error }}</td>
<td>{% if row.log %}<a href="{{ row.log }}">log</a>{% endif %}</td></tr>
{% endfor %}
</table></div></details>
{% endif %}

{% if logs %}
<details><summary>{{ logs|length }} logs that were kept, to watch and to check</summary>
<div class="scroll"><table>
<tr><th>log</th><th>which</th><th>replication</th><th>ended</th></tr>
{% for row in logs %}
<tr><td><a href="{{ row.log }}">{{ row.log }}</a></td><td>{{ row.cell }}</td>
<td class="n">{{ row.replication }}</td><td>{{ row.status }}</td></tr>
{% endfor %}
</table></div></details>
{% endif %}

{% if scenarios %}
<h2>What was compared</h2>
<table>
<tr><th>scenario</th><th>what it is</th></tr>
{% for name, about in scenarios %}<tr><td>{{ name }}</td><td>{{ about }}</td></tr>{% endfor %}
</table>
{% endif %}
{% if factors %}
<table>
<tr><th>factor</th><th>levels</th></tr>
{% for name, levels in factors %}
<tr><td><code>{{ name }}</code></td><td>{{ levels }}</td></tr>
{% endfor %}
</table>
{% endif %}

{% if references %}
<h2>Beside what is printed elsewhere</h2>
<div class="scroll"><table>
<tr><th>figure</th><th>printed</th><th>measured here</th><th>95 % interval</th><th>n</th></tr>
{% for r in references %}
<tr><td>{{ r.text }}</td><td class="n">{{ r.printed }}</td><td class="n">{{ r.measured }}</td>
<td class="n">{{ r.interval }}</td><td class="n">{{ r.n }}</td></tr>
{% endfor %}
</table></div>
{% endif %}

{% if differences %}
<h2>Differences to the baseline</h2>
<p class="note">Paired: both runs of a pair have the same hall, errands and fading. Bold where the
95 % interval does not contain zero, so that chance is an unlikely reason.</p>
<div class="scroll"><table>
<tr><th>which</th>{% for k in difference_kpis %}<th>{{ k }}</th>{% endfor %}</tr>
{% for name, cells in differences %}
<tr><td class="which">{{ name }}</td>{% for text, sure in cells %}
<td class="n{{ ' sure' if sure }}">{{ text }}</td>{% endfor %}</tr>
{% endfor %}
</table></div>
{% endif %}

<h2>Figures</h2>
<p class="note">Points are means over replications, bars their 95 % intervals (Student's t; for
shares of runs Wilson's).{% if common %} {{ common }}{% endif %}</p>
{% for figure in figures %}
<figure><img alt="{{ figure.title }}" src="data:image/svg+xml;base64,{{ figure.data }}">
<figcaption><b>{{ figure.title }}</b>{% if figure.says %}<br>{{ figure.says }}{% endif %}
</figcaption>
</figure>
{% endfor %}
{% if more_figures %}
<details><summary>{{ more_figures|length }} more: every key figure along every factor</summary>
{% for figure in more_figures %}
<figure><img loading="lazy" alt="{{ figure.title }}"
src="data:image/svg+xml;base64,{{ figure.data }}">
<figcaption>{{ figure.title }}</figcaption></figure>
{% endfor %}
</details>
{% endif %}

<h2>All means</h2>
<div class="scroll"><table>
<tr>{% for name in table_head %}<th>{{ name }}</th>{% endfor %}</tr>
{% for line in table %}
<tr>{% for text, number in line %}
<td{% if number %} class="n"{% endif %}>{{ text }}</td>
{% endfor %}</tr>
{% endfor %}
</table></div>
<p class="note">mean ± half the 95 % interval (number of runs it is the mean of). The same in
<code>summary.csv</code>; every single run in <code>runs.csv</code>.</p>

<h2>How to repeat it</h2>
<p class="note">{{ repeat }}</p>
<table>{% for name, value in versions %}
<tr><td>{{ name }}</td><td>{{ value }}</td></tr>
{% endfor %}</table>
</body>
</html>
"""
