defmodule Situ.Live.Html do
  @moduledoc false
  # Escapes values and converts rendered trees to HTML.
  alias Situ.Live.{Comprehension, Island, Rendered}

  @type safe :: {:safe, iodata()}

  @doc """
  Converts a template value to a string that is safe in HTML; trees are returned unchanged. `{:safe, iodata}` is not
  escaped, so never wrap untrusted strings in it. Invalid UTF-8 is replaced by `\uFFFD`, because a browser would reject
  the whole message.

      iex> Situ.Live.Html.escape("<script>")
      "&lt;script&gt;"
      iex> Situ.Live.Html.escape({:safe, "<b>"})
      "<b>"
  """
  @spec escape(term()) :: Rendered.value()
  def escape(value) when is_binary(value), do: escape_text(value)
  def escape(nil), do: ""
  def escape(:unchanged), do: :unchanged
  def escape(%Rendered{} = tree), do: tree
  def escape(%Comprehension{} = tree), do: tree
  def escape(%Island{} = tree), do: tree
  def escape({:safe, iodata}), do: iodata |> IO.iodata_to_binary() |> ensure_utf8()
  def escape({:escaped, text}), do: text
  def escape(value) when is_integer(value), do: Integer.to_string(value)
  def escape(value) when is_float(value), do: Float.to_string(value)
  def escape(value) when is_atom(value), do: value |> Atom.to_string() |> escape_text()
  def escape([]), do: ""
  def escape([%Rendered{} | _] = trees), do: build_comprehension(trees)
  def escape([%Island{} | _] = trees), do: build_comprehension(trees)
  def escape(value) when is_list(value), do: value |> IO.chardata_to_string() |> escape_text()
  def escape(value), do: value |> to_string() |> escape()

  @list_fingerprint :erlang.phash2({__MODULE__, :list}, 4_294_967_296)

  # A list of trees (`for` in Elixir code, several slots) is a comprehension without keys.
  defp build_comprehension(trees) do
    %Comprehension{
      static: ["", ""],
      fingerprint: @list_fingerprint,
      entries: Enum.map(trees, &{nil, [escape(&1)]})
    }
  end

  defp ensure_utf8(text) do
    if String.valid?(text),
      do: text,
      else: for(<<c <- text>>, into: "", do: replace_invalid_byte(c))
  end

  defp replace_invalid_byte(c) when c < 128, do: <<c>>
  defp replace_invalid_byte(_), do: "\uFFFD"

  # Most strings are ASCII without special characters, which one pass can verify.
  defp escape_text(text),
    do: if(plain_ascii?(text), do: text, else: text |> ensure_utf8() |> escape_bytes(""))

  defp plain_ascii?(<<c, rest::binary>>) when c < 128 and c not in [?<, ?>, ?&, ?", ?'],
    do: plain_ascii?(rest)

  defp plain_ascii?(""), do: true
  defp plain_ascii?(_), do: false

  defp escape_bytes(<<?<, rest::binary>>, acc), do: escape_bytes(rest, acc <> "&lt;")
  defp escape_bytes(<<?>, rest::binary>>, acc), do: escape_bytes(rest, acc <> "&gt;")
  defp escape_bytes(<<?&, rest::binary>>, acc), do: escape_bytes(rest, acc <> "&amp;")
  defp escape_bytes(<<?", rest::binary>>, acc), do: escape_bytes(rest, acc <> "&quot;")
  defp escape_bytes(<<?', rest::binary>>, acc), do: escape_bytes(rest, acc <> "&#39;")
  defp escape_bytes(<<c, rest::binary>>, acc), do: escape_bytes(rest, <<acc::binary, c>>)
  defp escape_bytes("", acc), do: acc

  @doc "Returns the HTML of a tree as iodata."
  @spec to_iodata(Rendered.value()) :: iodata()
  def to_iodata(%Rendered{static: static, dynamic: dynamic}),
    do: interleave_values(static, dynamic)

  def to_iodata(%Comprehension{static: static, entries: entries}) do
    for {_key, dynamic} <- entries, do: interleave_values(static, dynamic)
  end

  def to_iodata(%Island{rendered: rendered}), do: to_iodata(rendered)
  def to_iodata(text) when is_binary(text), do: text

  @doc "Returns the HTML of a tree as one string."
  @spec to_html(Rendered.value()) :: String.t()
  def to_html(tree), do: tree |> to_iodata() |> IO.iodata_to_binary()

  defp interleave_values([text], []), do: [text]

  defp interleave_values([text | texts], [value | values]),
    do: [text, to_iodata(value) | interleave_values(texts, values)]

  @doc """
  Renders attributes: `nil` and `false` omit an attribute, `true` writes only its name, and a list is joined with
  spaces.

      iex> Situ.Live.Html.attributes([{"id", "a"}, {"disabled", true}, {"hidden", false}])
      {:safe, [[" ", "id", "=\\"", "a", "\\""], [" ", "disabled"]]}
  """
  @spec attributes(Enumerable.t()) :: safe()
  def attributes(pairs) do
    {:safe,
     for(
       {name, value} <- pairs,
       value not in [nil, false],
       do: render_attribute(check_attribute_name(name), value)
     )}
  end

  @doc false
  # Renders one attribute whose name is in the template; `prefix` is a space and the name.
  def attribute_text(_prefix, value) when value in [nil, false], do: {:escaped, ""}
  def attribute_text(prefix, true), do: {:escaped, prefix}

  def attribute_text(prefix, value),
    do: {:escaped, <<prefix::binary, "=\"", escape(attribute_value(value))::binary, "\"">>}

  # Names come from a spread map, so characters that could end the name are rejected.
  defp check_attribute_name(name) do
    name = Kernel.to_string(name)

    if name =~ ~r/\A[^\s"'<>\/=]+\z/u,
      do: name,
      else: raise(ArgumentError, "invalid attribute name: #{inspect(name)}")
  end

  defp render_attribute(name, true), do: [" ", name]
  defp render_attribute(name, value), do: [" ", name, "=\"", escape(attribute_value(value)), "\""]

  @doc false
  def attribute_value(%Situ.Live.JS{} = js), do: Kernel.to_string(js)
  def attribute_value({:safe, _} = safe), do: safe

  def attribute_value(list) when is_list(list),
    do: list |> List.flatten() |> Enum.filter(& &1) |> Enum.join(" ")

  def attribute_value(value) when value in [nil, false], do: ""
  def attribute_value(value), do: value
end
