defmodule Situ.Annotation.Exchange.Xml do
  @moduledoc false
  # Parses untrusted XML with xmerl's SAX parser, which creates no atoms, to {name, attributes, children}. A document
  # type is rejected before its content is read, because it can declare entities that expand to gigabytes or read
  # files.

  @type element :: {String.t(), %{String.t() => String.t()}, [element() | String.t()]}
  @deepest 100

  @spec parse(binary()) :: {:ok, element()} | {:error, String.t()}
  def parse(text) do
    options = [event_fun: &handle_event/3, event_state: [], continuation_fun: &end_of_input/1]

    case :xmerl_sax_parser.stream(strip_bom(text), options) do
      {:ok, [{:root, element}], _rest} ->
        {:ok, element}

      {:ok, _, _} ->
        {:error, "it is not a complete XML document"}

      {:refused, _, why, _, _} ->
        {:error, to_string(why)}

      {_, {_, _, line}, reason, _, _} ->
        {:error, "line #{line} is not valid XML: #{text_of(reason)}"}
    end
  catch
    {:refused, why} -> {:error, why}
    kind, _ when kind in [:error, :exit] -> {:error, "it is not valid XML"}
  end

  defp strip_bom(<<0xEF, 0xBB, 0xBF, text::binary>>), do: text
  defp strip_bom(text), do: text

  # The parser asks for more input; there is none after the text.
  defp end_of_input(state), do: {<<>>, state}

  defp text_of(reason) when is_list(reason), do: reason |> :lists.flatten() |> to_string()
  defp text_of(reason), do: inspect(reason)

  defp handle_event({:startDTD, _, _, _}, _location, _stack),
    do:
      throw(
        {:refused,
         "it has a document type (<!DOCTYPE): annotation files do not need one, and its entities can be an attack"}
      )

  defp handle_event({:startElement, _, name, _, attributes}, _location, stack) do
    if length(stack) > @deepest,
      do: throw({:refused, "its elements are nested more than #{@deepest} deep"})

    attributes =
      Map.new(attributes, fn {_, _, key, value} -> {to_string(key), to_string(value)} end)

    [{to_string(name), attributes, []} | stack]
  end

  defp handle_event({:endElement, _, _, _}, _location, [{name, attributes, children} | stack]) do
    element = {name, attributes, Enum.reverse(children)}

    case stack do
      [] -> [{:root, element}]
      [{parent, own, siblings} | rest] -> [{parent, own, [element | siblings]} | rest]
    end
  end

  defp handle_event({:characters, text}, _location, [{name, attributes, children} | stack]),
    do: [{name, attributes, [to_string(text) | children]} | stack]

  defp handle_event(_event, _location, stack), do: stack

  @doc "Returns the child elements with that name."
  @spec list_children(element(), String.t()) :: [element()]
  def list_children({_, _, children}, name), do: for({^name, _, _} = child <- children, do: child)

  @doc "Returns the text of an element."
  @spec text_content(element()) :: String.t()
  def text_content({_, _, children}),
    do: for(text when is_binary(text) <- children, into: "", do: text)

  @doc "Escapes text for XML and removes the characters that XML cannot represent."
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
