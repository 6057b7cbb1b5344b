defmodule Situ.Live.Html do
  @moduledoc """
  Escapes values and converts rendered trees to HTML.

      iex> Situ.Live.Html.escape("<script>")
      "&lt;script&gt;"
      iex> Situ.Live.Html.escape({:safe, "<b>"})
      "<b>"
  """
  alias Situ.Live.{Comprehension, Island, Rendered}

  @type safe :: {:safe, iodata()}

  @doc """
  Converts a template value to a string that is safe in HTML; trees are returned unchanged. `{:safe, iodata}` is not
  escaped, so never wrap untrusted strings in it. Invalid UTF-8 is replaced by `\uFFFD`, because a browser would reject
  the whole message.
  """
  @spec escape(term()) :: Rendered.value()
  def escape(value) when is_binary(value), do: escape_text(value)
  def escape(nil), do: ""
  def escape(:unchanged), do: :unchanged
  def escape(%Rendered{} = tree), do: tree
  def escape(%Comprehension{} = tree), do: tree
  def escape(%Island{} = tree), do: tree
  def escape({:safe, iodata}), do: iodata |> IO.iodata_to_binary() |> utf8()
  def escape({:escaped, text}), do: text
  def escape(value) when is_integer(value), do: Integer.to_string(value)
  def escape(value) when is_float(value), do: Float.to_string(value)
  def escape(value) when is_atom(value), do: value |> Atom.to_string() |> escape_text()
  def escape([]), do: ""
  def escape([%Rendered{} | _] = trees), do: list(trees)
  def escape([%Island{} | _] = trees), do: list(trees)
  def escape(value) when is_list(value), do: value |> IO.chardata_to_string() |> escape_text()
  def escape(value), do: value |> to_string() |> escape()

  @list_fingerprint :erlang.phash2({__MODULE__, :list}, 4_294_967_296)

  # A list of trees (`for` in Elixir code, several slots) is a comprehension without keys.
  defp list(trees) do
    %Comprehension{
      static: ["", ""],
      fingerprint: @list_fingerprint,
      entries: Enum.map(trees, &{nil, [escape(&1)]})
    }
  end

  defp utf8(text) do
    if String.valid?(text), do: text, else: for(<<c <- text>>, into: "", do: mend(c))
  end

  defp mend(c) when c < 128, do: <<c>>
  defp mend(_), do: "\uFFFD"

  # Most strings are ASCII without special characters, which one pass can verify.
  defp escape_text(text), do: if(clean?(text), do: text, else: text |> utf8() |> replace(""))

  defp clean?(<<c, rest::binary>>) when c < 128 and c not in [?<, ?>, ?&, ?", ?'],
    do: clean?(rest)

  defp clean?(""), do: true
  defp clean?(_), do: false

  defp replace(<<?<, rest::binary>>, acc), do: replace(rest, acc <> "&lt;")
  defp replace(<<?>, rest::binary>>, acc), do: replace(rest, acc <> "&gt;")
  defp replace(<<?&, rest::binary>>, acc), do: replace(rest, acc <> "&amp;")
  defp replace(<<?", rest::binary>>, acc), do: replace(rest, acc <> "&quot;")
  defp replace(<<?', rest::binary>>, acc), do: replace(rest, acc <> "&#39;")
  defp replace(<<c, rest::binary>>, acc), do: replace(rest, <<acc::binary, c>>)
  defp replace("", acc), do: acc

  @doc "Returns the HTML of a tree as iodata."
  @spec to_iodata(Rendered.value()) :: iodata()
  def to_iodata(%Rendered{static: static, dynamic: dynamic}), do: weave(static, dynamic)

  def to_iodata(%Comprehension{static: static, entries: entries}) do
    for {_key, dynamic} <- entries, do: weave(static, dynamic)
  end

  def to_iodata(%Island{rendered: rendered}), do: to_iodata(rendered)
  def to_iodata(text) when is_binary(text), do: text

  @doc "Returns the HTML of a tree as one string."
  @spec to_html(Rendered.value()) :: String.t()
  def to_html(tree), do: tree |> to_iodata() |> IO.iodata_to_binary()

  defp weave([text], []), do: [text]

  defp weave([text | texts], [value | values]),
    do: [text, to_iodata(value) | weave(texts, values)]

  @doc """
  Renders attributes: `nil` and `false` omit an attribute, `true` writes only its name, and a list is joined with
  spaces.

      iex> Situ.Live.Html.attributes([{"id", "a"}, {"disabled", true}, {"hidden", false}])
      {:safe, [[" ", "id", "=\\"", "a", "\\""], [" ", "disabled"]]}
  """
  @spec attributes(Enumerable.t()) :: safe()
  def attributes(pairs) do
    {:safe,
     for({name, value} <- pairs, value not in [nil, false], do: attribute(name(name), value))}
  end

  @doc false
  # Renders one attribute whose name is in the template; `prefix` is a space and the name.
  def attribute_text(_prefix, value) when value in [nil, false], do: {:escaped, ""}
  def attribute_text(prefix, true), do: {:escaped, prefix}

  def attribute_text(prefix, value),
    do: {:escaped, <<prefix::binary, "=\"", escape(attribute_value(value))::binary, "\"">>}

  # Names come from a spread map, so characters that could end the name are rejected.
  defp name(name) do
    name = Kernel.to_string(name)

    if name =~ ~r/\A[^\s"'<>\/=]+\z/u,
      do: name,
      else: raise(ArgumentError, "invalid attribute name: #{inspect(name)}")
  end

  defp attribute(name, true), do: [" ", name]
  defp attribute(name, value), do: [" ", name, "=\"", escape(attribute_value(value)), "\""]

  @doc false
  def attribute_value(%Situ.Live.JS{} = js), do: Kernel.to_string(js)
  def attribute_value({:safe, _} = safe), do: safe

  def attribute_value(list) when is_list(list),
    do: list |> List.flatten() |> Enum.filter(& &1) |> Enum.join(" ")

  def attribute_value(value) when value in [nil, false], do: ""
  def attribute_value(value), do: value
end
