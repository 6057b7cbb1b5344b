defmodule Situ.Build.ModulePage do
  @moduledoc false
  # The page of a module on the API site, as Markdown.
  alias Situ.Build.{DocLinks, Markdown, ModuleDocs}

  @sections [
    {"Types", [:type]},
    {"Callbacks", [:callback, :macrocallback]},
    {"Functions", [:function, :macro]}
  ]

  @doc "Renders the page of a module. `status` is `\"stable\"` or `\"experimental\"`."
  @spec render_page(ModuleDocs.t(), String.t(), DocLinks.t()) :: String.t()
  def render_page(module, status, links) do
    place = %{page: "api/#{module.name}.html", file: module.path, module: module.name}
    source = DocLinks.source_link(links, module.path, module.line)

    IO.iodata_to_binary([
      "---\norphan: true\ntocdepth: 3\n---\n\n# #{module.name}\n\n",
      ~s(<p class="facts"><span class="status #{status}">#{status}</span> in the application ),
      ~s(<code>#{module.app}</code> · <a href="#{source}">source</a></p>\n\n),
      render_text(module.text, 2, links, place),
      render_fields(module),
      for({title, kinds} <- @sections, do: render_section(title, kinds, module, {links, place}))
    ])
  end

  defp render_text(text, level, links, place) do
    text = text |> Markdown.shift_headings(level) |> Markdown.fence_code("elixir")
    [DocLinks.link_text(links, text, place), "\n\n"]
  end

  defp render_fields(%{fields: nil}), do: []

  defp render_fields(module) do
    fields = Enum.map_join(module.fields, ", ", &"`#{&1}`")
    if fields == "", do: [], else: ["**Fields**: ", fields, "\n\n"]
  end

  defp render_section(title, kinds, module, context) do
    case module.entries
         |> Enum.filter(&(&1.kind in kinds))
         |> Enum.sort_by(&{&1.name, &1.arity}) do
      [] ->
        []

      entries ->
        [
          "## #{title}\n\n",
          render_summary(entries),
          Enum.map(entries, &render_entry(&1, module, context))
        ]
    end
  end

  defp render_summary([_single]), do: []

  defp render_summary(entries) do
    [
      ~s(<table class="summary"><tbody>\n),
      for entry <- entries do
        text = if entry.deprecated, do: "Deprecated. #{entry.text}", else: entry.text
        summary = text |> first_sentence() |> DocLinks.escape_html() |> format_inline()

        name = entry |> short_name() |> DocLinks.escape_html()

        ~s(<tr><td><a href="##{DocLinks.anchor(entry)}"><code>#{name}</code></a></td>) <>
          "<td>#{summary}</td></tr>\n"
      end,
      "</tbody></table>\n\n"
    ]
  end

  defp short_name(entry), do: "#{entry.name}/#{entry.arity}"

  defp first_sentence(nil), do: ""

  defp first_sentence(text) do
    text
    |> String.split("\n\n", parts: 2)
    |> hd()
    |> String.replace(~r/\s+/, " ")
    |> String.split(~r/(?<=[.:]) (?=[A-Z])/, parts: 2)
    |> hd()
  end

  defp format_inline(html) do
    html
    |> String.replace(~r/`([^`]+)`/, "<code>\\1</code>")
    |> String.replace(~r/\[([^\]]+)\]\([^)]+\)/, "\\1")
    |> String.replace(~r/\*\*([^*]+)\*\*/, "<strong>\\1</strong>")
  end

  defp render_entry(entry, module, {links, place}) do
    source = DocLinks.source_link(links, module.path, entry.line)

    [
      for(arity <- entry.arities, do: render_anchor(%{entry | arity: arity})),
      "\n\n### #{short_name(entry)}\n\n",
      ~s(<pre class="signature"><code>),
      DocLinks.escape_html(entry.signature),
      render_code(entry, links, place),
      "</code></pre>\n",
      ~s(<p class="facts">),
      Enum.intersperse(
        entry_facts(entry) ++
          [~s(<a href="#{source}" aria-label="Source of #{short_name(entry)}">source</a>)],
        " · "
      ),
      "</p>\n\n",
      render_deprecation(entry, links, place),
      render_text(entry.text || "", 4, links, place)
    ]
  end

  defp render_anchor(entry), do: ~s(<span class="anchor" id="#{DocLinks.anchor(entry)}"></span>)

  defp render_code(%{code: ""}, _links, _place), do: []
  defp render_code(entry, links, place), do: ["\n", DocLinks.link_code(links, entry.code, place)]

  defp entry_facts(entry) do
    macro = if entry.kind in [:macro, :macrocallback], do: ["macro"], else: []
    since = if entry.since, do: ["since #{entry.since}"], else: []
    macro ++ since
  end

  defp render_deprecation(%{deprecated: nil}, _links, _place), do: []

  defp render_deprecation(entry, links, place),
    do: ["> **Deprecated**: ", DocLinks.link_text(links, entry.deprecated, place), "\n\n"]
end
