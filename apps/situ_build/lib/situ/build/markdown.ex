defmodule Situ.Build.Markdown do
  @moduledoc false
  # Adapts Markdown to its page on the API site: levels of headings, languages of code blocks, and anchors that links
  # on GitHub use.

  @doc """
  Moves the headings so that the highest one has `level`.

      iex> Situ.Build.Markdown.shift_headings("# Options\\n\\n## More", 4)
      "#### Options\\n\\n##### More"
  """
  @spec shift_headings(String.t(), pos_integer()) :: String.t()
  def shift_headings(text, level) do
    levels =
      for {:text, line} <- mark_lines(text),
          [_, marks, _] <- [match_heading(line)],
          do: byte_size(marks)

    case Enum.min(levels, fn -> level end) do
      ^level -> text
      highest -> map_text(text, &shift_line(&1, level - highest))
    end
  end

  defp shift_line(line, by) do
    case match_heading(line) do
      [_, marks, title] -> String.duplicate("#", min(byte_size(marks) + by, 6)) <> " " <> title
      nil -> line
    end
  end

  @doc """
  Adds an anchor before each heading whose name on GitHub differs from its name on the site.

      iex> Situ.Build.Markdown.add_anchors("## 1. A model")
      ~s(<span id="1-a-model"></span>\\n\\n## 1. A model)
      iex> Situ.Build.Markdown.add_anchors("## Models")
      "## Models"
  """
  @spec add_anchors(String.t()) :: String.t()
  def add_anchors(text) do
    map_text(text, fn line ->
      case match_heading(line) do
        [_, _, title] -> anchor_line(title, line)
        nil -> line
      end
    end)
  end

  defp anchor_line(title, line) do
    case {github_anchor(title), site_anchor(title)} do
      {same, same} -> line
      {github, _site} -> ~s(<span id="#{github}"></span>\n\n) <> line
    end
  end

  @doc """
  Returns the anchor of a heading on GitHub.

      iex> Situ.Build.Markdown.github_anchor("1. A `model`, and more")
      "1-a-model-and-more"
  """
  @spec github_anchor(String.t()) :: String.t()
  def github_anchor(title) do
    title
    |> String.replace(~r/\[([^\]]*)\]\([^)]*\)/, "\\1")
    |> String.downcase()
    |> String.replace(~r/[^\p{L}\p{N}_ -]/u, "")
    |> String.replace(" ", "-")
  end

  # The generator of the site (docutils) makes this anchor.
  defp site_anchor(title) do
    title
    |> String.downcase()
    |> String.replace(~r/[^a-z0-9]+/, "-")
    |> String.replace(~r/^[-0-9]+|-+$/, "")
  end

  @doc """
  Gives indented code blocks a language: `iex` for doctests, `console` for commands, otherwise `default`.

      iex> Situ.Build.Markdown.fence_code("Text:\\n\\n    iex> 1 + 1\\n    2\\n\\nMore", "elixir")
      "Text:\\n\\n```iex\\niex> 1 + 1\\n2\\n```\\n\\nMore"
  """
  @spec fence_code(String.t(), String.t()) :: String.t()
  def fence_code(text, default) do
    text
    |> mark_lines()
    |> Enum.chunk_by(fn {kind, _} -> kind == :code end)
    |> Enum.map_join("\n", fn
      [{:code, _} | _] = lines -> fence_lines(Enum.map(lines, &elem(&1, 1)), default)
      lines -> Enum.map_join(lines, "\n", &elem(&1, 1))
    end)
  end

  defp fence_lines(lines, default) do
    {blank, lines} = lines |> Enum.reverse() |> Enum.split_while(&(String.trim(&1) == ""))
    code = lines |> Enum.reverse() |> Enum.map(&String.replace(&1, ~r/^ {1,4}/, ""))
    Enum.join(["```" <> guess_language(code, default) | code] ++ ["```" | blank], "\n")
  end

  defp guess_language(code, default) do
    cond do
      Enum.any?(code, &String.starts_with?(&1, "iex>")) -> "iex"
      Enum.any?(code, &(&1 =~ ~r/^\$ /)) -> "console"
      Enum.any?(code, &(&1 =~ ~r/[│├└┌─▶►]|--+>|\|\s*$/)) -> "text"
      true -> default
    end
  end

  # Marks each line as text, as part of a fenced block, or as indented code. Indented lines after an item of a list
  # belong to the list.
  defp mark_lines(text) do
    {lines, _} = text |> String.split("\n") |> Enum.map_reduce({:text, false}, &mark_line/2)
    lines
  end

  defp mark_line(line, {:fence, list?}) do
    state = if fence?(line), do: {:text, list?}, else: {:fence, list?}
    {{:fence, line}, state}
  end

  defp mark_line(line, {:code, false}) do
    if line =~ ~r/^( {4}|\s*$)/, do: {{:code, line}, {:code, false}}, else: mark_text(line, false)
  end

  defp mark_line("", {_kind, list?}), do: {{:text, ""}, {:blank, list?}}
  defp mark_line("    " <> _ = line, {:blank, false}), do: {{:code, line}, {:code, false}}
  defp mark_line(line, {_kind, list?}), do: mark_text(line, list?)

  defp mark_text(line, list?) do
    cond do
      fence?(line) -> {{:fence, line}, {:fence, list?}}
      line =~ ~r/^ *([-*+]|\d+[.)]) / -> {{:text, line}, {:text, true}}
      line =~ ~r/^\S/ -> {{:text, line}, {:text, false}}
      true -> {{:text, line}, {:text, list?}}
    end
  end

  defp match_heading(line), do: Regex.run(~r/^(\#{1,6}) +(.+?) *$/, line)

  defp fence?(line), do: line =~ ~r/^ *(```|~~~)/

  defp map_text(text, function) do
    text
    |> mark_lines()
    |> Enum.map_join("\n", fn
      {:text, line} -> function.(line)
      {_kind, line} -> line
    end)
  end
end
