defmodule Situ.Live.Test.Dom do
  @moduledoc false
  # Parses enough HTML to find the elements that a test selects. A node is a string or `{tag, attributes, children}`.
  #
  # Selectors: `tag`, `#id`, `.class`, `[name]`, `[name=value]`, combined without spaces; a space selects descendants.

  @void ~w(area base br col embed hr img input link meta param source track wbr)

  @type t :: String.t() | {String.t(), %{optional(String.t()) => String.t()}, [t()]}

  @spec parse(String.t()) :: [t()]
  def parse(html) do
    {nodes, _rest} = children(html, nil, [])
    nodes
  end

  defp children("", _tag, acc), do: {Enum.reverse(acc), ""}

  defp children("<!--" <> rest, tag, acc) do
    [_, rest] = :binary.split(rest, "-->")
    children(rest, tag, acc)
  end

  defp children("<!" <> rest, tag, acc) do
    [_, rest] = :binary.split(rest, ">")
    children(rest, tag, acc)
  end

  defp children("</" <> rest, _tag, acc) do
    [_name, rest] = :binary.split(rest, ">")
    {Enum.reverse(acc), rest}
  end

  defp children("<" <> rest, tag, acc) do
    [name, rest] = Regex.run(~r/\A([a-zA-Z][^\s\/>]*)(.*)\z/s, rest, capture: :all_but_first)
    {attributes, rest} = attributes(rest, %{})

    {inner, rest} =
      cond do
        name in @void -> {[], rest}
        name in ["script", "style"] -> raw(rest, name)
        true -> children(rest, name, [])
      end

    children(rest, tag, [{name, attributes, inner} | acc])
  end

  defp children(text, tag, acc) do
    {text, rest} =
      case :binary.match(text, "<") do
        {at, _} -> split(text, at)
        :nomatch -> {text, ""}
      end

    children(rest, tag, [unescape(text) | acc])
  end

  defp split(text, at),
    do: {binary_part(text, 0, at), binary_part(text, at, byte_size(text) - at)}

  defp raw(html, name) do
    [text, rest] = :binary.split(html, "</#{name}>")
    {[text], rest}
  end

  defp attributes(html, acc) do
    case String.trim_leading(html) do
      ">" <> rest ->
        {acc, rest}

      "/>" <> rest ->
        {acc, rest}

      html ->
        [_, name, value, rest] = Regex.run(~r/\A([^\s=\/>]+)(?:="([^"]*)")?(.*)\z/s, html)

        attributes(rest, Map.put(acc, name, unescape(value)))
    end
  end

  defp unescape(text) do
    text
    |> String.replace("&lt;", "<")
    |> String.replace("&gt;", ">")
    |> String.replace("&quot;", "\"")
    |> String.replace("&#39;", "'")
    |> String.replace("&amp;", "&")
  end

  @spec all([t()], String.t()) :: [t()]
  def all(nodes, selector) do
    selector
    |> String.split()
    |> Enum.map(&compound/1)
    |> Enum.reduce(nodes, fn
      wanted, ^nodes ->
        below(nodes, wanted)

      wanted, found ->
        found |> Enum.flat_map(fn {_, _, inner} -> below(inner, wanted) end) |> Enum.uniq()
    end)
  end

  defp below(nodes, wanted) do
    Enum.flat_map(nodes, fn
      {_, _, inner} = element ->
        here = if Enum.all?(wanted, &fits?(&1, element)), do: [element], else: []
        here ++ below(inner, wanted)

      _text ->
        []
    end)
  end

  @part ~r/#([\w:.-]+?)(?=[#.\[]|\z)|\.([\w:-]+)|\[([\w:-]+)(?:=["']?([^"'\]]*)["']?)?\]|([a-zA-Z][\w-]*)/

  defp compound(text) do
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

  defp fits?({:tag, tag}, {tag, _, _}), do: true
  defp fits?({:has, name}, {_, attributes, _}), do: is_map_key(attributes, name)
  defp fits?({:attribute, name, value}, {_, attributes, _}), do: attributes[name] == value

  defp fits?({:class, class}, {_, attributes, _}),
    do: class in String.split(Map.get(attributes, "class", ""))

  defp fits?(_, _), do: false

  @spec text(t() | [t()]) :: String.t()
  def text(nodes) when is_list(nodes), do: Enum.map_join(nodes, &text/1)
  def text({_, _, inner}), do: text(inner)
  def text(text), do: text
end
