defmodule Situ.Xml do
  @moduledoc false
  # Parses untrusted XML with the SAX parser of Erlang's xmerl, which creates no atoms. A document type with
  # declarations or an external file is rejected before its content is read, because it can declare entities that expand
  # to gigabytes or read files. The size of the result is bounded by the size of the document, and its depth by
  # `@max_depth`.

  @typedoc "A name, attributes, and the child elements and texts in their order."
  @type element :: {String.t(), %{String.t() => String.t()}, [element() | String.t()]}
  @max_depth 200

  @doc """
  Parses a document and returns its root element, or the reason why the document is invalid. With `texts: false`, the
  elements contain no texts.

      iex> Situ.Xml.parse(~s(<a b="1">x &amp; <c/> </a>))
      {:ok, {"a", %{"b" => "1"}, ["x & ", {"c", %{}, []}, " "]}}
      iex> Situ.Xml.parse("<!DOCTYPE a []><a/>")
      {:error, "it has a document type (<!DOCTYPE), which is not allowed: its entities can be an attack"}
  """
  @spec parse(binary(), keyword()) :: {:ok, element()} | {:error, String.t()}
  def parse(document, opts \\ []) do
    texts? = Keyword.get(opts, :texts, true)

    with {:ok, [root]} <- reduce_events(document, [], &build_tree(&1, &2, texts?)),
         do: {:ok, root}
  end

  @doc """
  Reduces the events of `:xmerl_sax_parser` with `fun`. Returns the final state, or the reason why the document is
  invalid.
  """
  @spec reduce_events(binary(), state, (event :: term(), state -> state)) ::
          {:ok, state} | {:error, String.t()}
        when state: term()
  def reduce_events(document, state, fun) do
    handle_event = fn event, _location, {depth, state} ->
      {check_event(event, depth), fun.(event, state)}
    end

    options = [
      event_fun: handle_event,
      event_state: {0, state},
      continuation_fun: &end_input/1
    ]

    case :xmerl_sax_parser.stream(strip_bom(document), options) do
      {:ok, {_depth, state}, _rest} -> {:ok, state}
      {:refused, _location, why, _open, _state} -> {:error, why}
      {_kind, {_, _, line}, reason, _open, _state} -> malformed_error(line, reason)
    end
  catch
    {:refused, why} -> {:error, why}
    kind, _reason when kind in [:error, :exit] -> {:error, "it is not well-formed XML"}
  end

  defp strip_bom(<<0xEF, 0xBB, 0xBF, document::binary>>), do: document
  defp strip_bom(document), do: document

  # The parser asks for more input at the end of the document.
  defp end_input(state), do: {<<>>, state}

  # Returns the depth after an event.
  defp check_event({:startDTD, _, _, _}, _depth) do
    throw(
      {:refused,
       "it has a document type (<!DOCTYPE), which is not allowed: its entities can be an attack"}
    )
  end

  defp check_event({:startElement, _, _, _, _}, depth) when depth >= @max_depth,
    do: throw({:refused, "its elements are nested too deeply (more than #{@max_depth} levels)"})

  defp check_event({:startElement, _, _, _, _}, depth), do: depth + 1
  defp check_event({:endElement, _, _, _}, depth), do: depth - 1
  defp check_event(_event, depth), do: depth

  defp malformed_error(line, reason),
    do: {:error, "line #{line} is not well-formed XML: #{format_reason(reason)}"}

  defp format_reason(reason) when is_list(reason) do
    case :unicode.characters_to_binary(reason) do
      text when is_binary(text) -> text
      _ -> "it contains invalid characters"
    end
  end

  defp format_reason(reason), do: inspect(reason, limit: 5)

  # The state lists the open elements, innermost first. The last one to close is the root.
  defp build_tree({:startElement, _, name, _, attributes}, open, _texts?) do
    attributes =
      for {_, _, key, value} <- attributes, into: %{}, do: {to_string(key), to_string(value)}

    [{to_string(name), attributes, []} | open]
  end

  defp build_tree({:endElement, _, _, _}, [{name, attributes, children} | open], _texts?) do
    element = {name, attributes, Enum.reverse(children)}

    case open do
      [] -> [element]
      [{parent, own, siblings} | open] -> [{parent, own, [element | siblings]} | open]
    end
  end

  defp build_tree({kind, text}, [{name, attributes, children} | open], true)
       when kind in [:characters, :ignorableWhitespace],
       do: [{name, attributes, [to_string(text) | children]} | open]

  defp build_tree(_event, open, _texts?), do: open

  @doc """
  Returns the child elements with that name.

      iex> Situ.Xml.list_children({"a", %{}, ["x", {"b", %{}, []}, {"c", %{}, []}]}, "b")
      [{"b", %{}, []}]
  """
  @spec list_children(element(), String.t()) :: [element()]
  def list_children({_, _, children}, name), do: for({^name, _, _} = child <- children, do: child)

  @doc "Returns the first child element with that name, or `nil`."
  @spec find_child(element(), String.t()) :: element() | nil
  def find_child({_, _, children}, name), do: List.keyfind(children, name, 0)

  @doc """
  Returns the text of an element, without the texts of its children.

      iex> Situ.Xml.text_content({"a", %{}, ["x", {"b", %{}, ["y"]}, "z"]})
      "xz"
  """
  @spec text_content(element()) :: String.t()
  def text_content({_, _, children}),
    do: for(text when is_binary(text) <- children, into: "", do: text)

  @doc ~S"""
  Escapes text for XML and removes the characters that XML cannot represent.

      iex> Situ.Xml.escape("a < \"b\"\0")
      "a &lt; &quot;b&quot;"
  """
  @spec escape(String.t()) :: String.t()
  def escape(text) do
    text
    |> String.replace(~r/[\x00-\x08\x0b\x0c\x0e-\x1f\x{fffe}\x{ffff}]/u, "")
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
    |> String.replace("\r", "&#13;")
  end
end
