"""How the report looks."""

from __future__ import annotations

STYLE = """
:root{color-scheme:light}
*{box-sizing:border-box}
body{margin:0;background:#f6f8fa;color:#1f2328;font:15px/1.5 system-ui,"Segoe UI",sans-serif}
main{max-width:70rem;margin:0 auto;padding:2rem 1.25rem 4rem}
h1{margin:0;font-size:1.75rem;letter-spacing:-.01em}
h2{margin:0 0 .6rem;font-size:1.05rem}
.lead{margin:.2rem 0 1.4rem;color:#57606a}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.8rem}
.cards div,figure,table{background:#fff;border:1px solid #d0d7de;border-radius:8px}
.cards div{padding:.8rem 1rem}
.cards b{display:block;white-space:nowrap;font-size:1.35rem;font-variant-numeric:tabular-nums}
.cards span{color:#57606a;font-size:.85rem;line-height:1.3;display:block}
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(26rem,1fr));gap:.8rem;
margin-top:.8rem}
figure{margin:0;padding:1rem;display:flex;flex-direction:column}
figcaption{margin-top:auto;padding-top:.6rem;color:#57606a;font-size:.88rem}
svg,img{display:block;width:100%;height:auto;max-height:25rem;object-fit:contain;margin:0 auto}
main>h2{margin:2rem 0 .6rem}
table{border-collapse:separate;border-spacing:0;width:100%;overflow:hidden}
th,td{padding:.4rem 1rem;text-align:left;border-bottom:1px solid #eaeef2;vertical-align:top}
tr:last-child>*{border-bottom:0}
th{font-weight:500;color:#57606a;width:16rem}
td{font-variant-numeric:tabular-nums}
@media print{body{background:#fff}figure{break-inside:avoid}}
"""
