defmodule Situ.Live.Test.Dom do
  @moduledoc false
  # Parses enough HTML to find the elements that a test selects. A node is a string or `{tag, attributes, children}`.
  #
  # Selectors: `tag`, `#id`, `.class`, `[name]`, `[name=value]`, combined without spaces; a space selects descendants.

  @void ~w(area base br col embed hr img input link meta param source track wbr)

  @type t :: String.t() | {String.t(), %{optional(String.t()) => String.t()}, [t()]}

  @spec parse(String.t()) :: [t()]
  def parse(html) do
    {nodes, _rest} = parse_children(html, nil, [])
    nodes
  end

  defp parse_children("", _tag, acc), do: {Enum.reverse(acc), ""}

  defp parse_children("<!--" <> rest, tag, acc) do
    [_, rest] = :binary.split(rest, "-->")
    parse_children(rest, tag, acc)
  end

  defp parse_children("<!" <> rest, tag, acc) do
    [_, rest] = :binary.split(rest, ">")
    parse_children(rest, tag, acc)
  end

  defp parse_children("</" <> rest, _tag, acc) do
    [_name, rest] = :binary.split(rest, ">")
    {Enum.reverse(acc), rest}
  end

  defp parse_children("<" <> rest, tag, acc) do
    [name, rest] = Regex.run(~r/\A([a-zA-Z][^\s\/>]*)(.*)\z/s, rest, capture: :all_but_first)
    {attributes, rest} = parse_attributes(rest, %{})

    {inner, rest} =
      cond do
        name in @void -> {[], rest}
        name in ["script", "style"] -> take_raw_text(rest, name)
        true -> parse_children(rest, name, [])
      end

    parse_children(rest, tag, [{name, attributes, inner} | acc])
  end

  defp parse_children(text, tag, acc) do
    {text, rest} =
      case :binary.match(text, "<") do
        {at, _} -> split_at(text, at)
        :nomatch -> {text, ""}
      end

    parse_children(rest, tag, [unescape_entities(text) | acc])
  end

  defp split_at(text, at),
    do: {binary_part(text, 0, at), binary_part(text, at, byte_size(text) - at)}

  defp take_raw_text(html, name) do
    [text, rest] = :binary.split(html, "</#{name}>")
    {[text], rest}
  end

  defp parse_attributes(html, acc) do
    case String.trim_leading(html) do
      ">" <> rest ->
        {acc, rest}

      "/>" <> rest ->
        {acc, rest}

      html ->
        [_, name, value, rest] = Regex.run(~r/\A([^\s=\/>]+)(?:="([^"]*)")?(.*)\z/s, html)

        parse_attributes(rest, Map.put(acc, name, unescape_entities(value)))
    end
  end

  defp unescape_entities(text) do
    text
    |> String.replace("&lt;", "<")
    |> String.replace("&gt;", ">")
    |> String.replace("&quot;", "\"")
    |> String.replace("&#39;", "'")
    |> String.replace("&amp;", "&")
  end

  @spec find_all([t()], String.t()) :: [t()]
  def find_all(nodes, selector) do
    selector
    |> String.split()
    |> Enum.map(&parse_compound/1)
    |> Enum.reduce(nodes, fn
      parts, ^nodes ->
        find_below(nodes, parts)

      parts, elements ->
        elements |> Enum.flat_map(fn {_, _, inner} -> find_below(inner, parts) end) |> Enum.uniq()
    end)
  end

  defp find_below(nodes, parts) do
    Enum.flat_map(nodes, fn
      {_, _, inner} = element ->
        matches = if Enum.all?(parts, &matches_part?(&1, element)), do: [element], else: []
        matches ++ find_below(inner, parts)

      _text ->
        []
    end)
  end

  @part ~r/#([\w:.-]+?)(?=[#.\[]|\z)|\.([\w:-]+)|\[([\w:-]+)(?:=["']?([^"'\]]*)["']?)?\]|([a-zA-Z][\w-]*)/

  defp parse_compound(text) do
    parts = Regex.scan(@part, text)

    if parts |> Enum.map_join(&hd/1) != text,
      do: raise(ArgumentError, "unsupported selector: #{inspect(text)}")

    Enum.map(parts, fn
      [_, id] -> {:attribute, "id", id}
      [_, "", class] -> {:class, class}
      [_, "", "", name] -> {:has, name}
      [_, "", "", name, value] -> {:attribute, name, value}
      [_, "", "", "", "", tag] -> {:tag, tag}
    end)
  end

  defp matches_part?({:tag, tag}, {tag, _, _}), do: true
  defp matches_part?({:has, name}, {_, attributes, _}), do: is_map_key(attributes, name)
  defp matches_part?({:attribute, name, value}, {_, attributes, _}), do: attributes[name] == value

  defp matches_part?({:class, class}, {_, attributes, _}),
    do: class in String.split(Map.get(attributes, "class", ""))

  defp matches_part?(_, _), do: false

  @spec text_content(t() | [t()]) :: String.t()
  def text_content(nodes) when is_list(nodes), do: Enum.map_join(nodes, &text_content/1)
  def text_content({_, _, inner}), do: text_content(inner)
  def text_content(text), do: text
end
