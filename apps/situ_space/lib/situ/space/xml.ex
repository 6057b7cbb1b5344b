defmodule Situ.Space.Xml do
  @moduledoc false
  # Parses untrusted XML. Document types are rejected, because their entities may grow without limit or refer to other
  # files. Only UTF-8 is accepted, and names do not become atoms.

  @typedoc "A name, attributes and child elements; with `texts: true` the text is the attribute `:text`."
  @type element :: {String.t(), %{(String.t() | :text) => String.t()}, [element()]}
  @deepest 200

  @doc """
  Reduces the events of `:xmerl_sax_parser` with `fun`. Returns the final state, or the reason why the XML is invalid.
  """
  @spec reduce_events(binary(), (term(), term(), state -> state), state) ::
          {:ok, state} | {:error, String.t()}
        when state: term()
  def reduce_events(bytes, fun, state) do
    cond do
      :binary.match(bytes, ["<!DOCTYPE", "<!ENTITY"]) != :nomatch ->
        {:error, "it has a document type, which is not allowed"}

      :binary.match(bytes, <<0>>) != :nomatch ->
        {:error, "it is not well-formed XML in UTF-8"}

      true ->
        parse_events(bytes, fun, state)
    end
  end

  defp parse_events(bytes, fun, state) do
    case :xmerl_sax_parser.stream(bytes, event_fun: fun, event_state: state) do
      {:ok, state, _rest} -> {:ok, state}
      {_error, _where, reason, _open, _state} -> malformed_error(reason)
      {:error, reason} -> malformed_error(reason)
    end
  catch
    _kind, reason -> malformed_error(reason)
  end

  defp malformed_error(reason) when is_list(reason) do
    case :unicode.characters_to_binary(reason) do
      text when is_binary(text) -> {:error, "it is not well-formed XML: #{text}"}
      _ -> {:error, "it is not well-formed XML"}
    end
  end

  defp malformed_error(reason),
    do: {:error, "it is not well-formed XML: #{inspect(reason, limit: 5)}"}

  @doc """
  Parses XML to a tree of elements; with `texts: true` they contain their texts.

      iex> Situ.Space.Xml.parse_tree(~s(<a b="1"><c/></a>))
      {:ok, {"a", %{"b" => "1"}, [{"c", %{}, []}]}}
      iex> Situ.Space.Xml.parse_tree("<a>1 <b>x</b>2</a>", texts: true)
      {:ok, {"a", %{text: "1 2"}, [{"b", %{text: "x"}, []}]}}
  """
  @spec parse_tree(binary(), keyword()) :: {:ok, element()} | {:error, String.t()}
  def parse_tree(bytes, opts \\ []) do
    case reduce_events(bytes, if(opts[:texts], do: &build_text_tree/3, else: &build_tree/3), []) do
      {:ok, [root]} -> {:ok, root}
      {:ok, :deep} -> {:error, "its elements are nested too deeply"}
      {:ok, _} -> {:error, "it has no elements"}
      error -> error
    end
  end

  # The state lists the open elements, innermost first. The last one to close is the root.
  defp build_tree(_event, _where, :deep), do: :deep

  defp build_tree({:startElement, _, _, _, _}, _, open) when length(open) > @deepest, do: :deep

  defp build_tree({:startElement, _, name, _, attributes}, _, open) do
    given =
      for {_, _, key, value} <- attributes, into: %{}, do: {to_string(key), to_string(value)}

    [{to_string(name), given, []} | open]
  end

  defp build_tree({:endElement, _, _, _}, _, [
         {name, given, inner},
         {outer, attributes, found} | open
       ]),
       do: [{outer, attributes, [{name, given, Enum.reverse(inner)} | found]} | open]

  defp build_tree({:endElement, _, _, _}, _, [{name, given, inner}]),
    do: [{name, given, Enum.reverse(inner)}]

  defp build_tree(_event, _where, open), do: open

  # Works like `build_tree/3`, but collects the texts of an element and joins them when it closes.
  defp build_text_tree({:characters, text}, _, [{name, given, inner} | open]) do
    part = :unicode.characters_to_binary(text)
    [{name, Map.update(given, :text, [part], &[&1 | [part]]), inner} | open]
  end

  defp build_text_tree({:endElement, _, _, _} = event, where, [
         {name, %{text: parts} = given, inner} | open
       ]),
       do:
         build_tree(event, where, [
           {name, %{given | text: IO.iodata_to_binary(parts)}, inner} | open
         ])

  defp build_text_tree(event, where, open), do: build_tree(event, where, open)
end
