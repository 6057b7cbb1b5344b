defmodule Situ.Bridge.Mcap.Extra do
  @moduledoc false
  # Fields of messages that Situ's types have no place for: headers, covariances, further fields of points. An import
  # keeps them in a second stream, and the schema in the metadata of the first one. An export puts both back.
  alias Situ.{Message, Store}
  alias Situ.Store.StreamInfo

  @ending ".extra"
  # Streams of extras have numbers above those of channels and connections.
  @number 0x1_0000_0000

  @typedoc "The name of a type, the language of its definition, and the definition."
  @type schema :: {name :: String.t(), language :: String.t(), definition :: binary()}

  @doc "Returns the name of the second stream."
  @spec name(String.t()) :: String.t()
  def name(name), do: name <> @ending

  @doc "Returns the number of the second stream."
  @spec number(non_neg_integer()) :: non_neg_integer()
  def number(id), do: id + @number

  @doc "Returns what an import keeps with a stream: the pairs that its writer gave, and its schema."
  @spec metadata([{String.t(), String.t()}], schema() | nil) :: {String.t(), binary()} | nil
  def metadata([], nil), do: nil

  def metadata(pairs, schema),
    do: {"map", pairs |> Map.new() |> put_schema(schema) |> :erlang.term_to_binary()}

  defp put_schema(metadata, nil), do: metadata

  defp put_schema(metadata, {name, language, definition}) do
    schema = %{"name" => name, "encoding" => language, "definition" => definition}
    Map.put(metadata, "schema", schema)
  end

  @doc "Returns the fields of a message that another one does not have, and its header."
  @spec take(map(), map()) :: map()
  def take(message, rewritten) do
    extra = without(message, rewritten)
    if header = message["header"], do: Map.put(extra, "header", header), else: extra
  end

  defp without(message, rewritten) do
    for {key, value} <- message, rest = differing(value, Map.get(rewritten, key)), into: %{} do
      {:rest, rest} = rest
      {key, rest}
    end
  end

  defp differing(value, value), do: nil

  defp differing(%{} = value, %{} = other)
       when not is_struct(value) and not is_struct(other) do
    rest = without(value, other)
    if rest == %{}, do: nil, else: {:rest, rest}
  end

  defp differing(value, _other), do: {:rest, value}

  @doc "Puts the extra fields into a message."
  @spec put(term(), map()) :: term()
  def put(message, extra) when extra == %{} or not is_map(message), do: message

  def put(message, extra) do
    Map.merge(message, extra, fn
      _key, %{} = value, %{} = more when not is_struct(value) and not is_struct(more) ->
        put(value, more)

      _key, _value, more ->
        more
    end)
  end

  @doc "Returns the streams of extra fields, by the names of the streams that they belong to."
  @spec streams([StreamInfo.t()]) :: %{String.t() => StreamInfo.t()}
  def streams(infos) do
    by_name = Map.new(infos, &{&1.name, &1})

    for %{name: base, count: count} <- infos,
        %{count: ^count} = extra <- [by_name[name(base)]],
        into: %{},
        do: {base, extra}
  end

  @doc "Joins messages from `ordinal` on with their extra fields: the data become `{:with_extra, data, extra}`."
  @spec join([Message.t()], Store.t(), StreamInfo.t() | nil, non_neg_integer()) :: [Message.t()]
  def join(messages, _store, nil, _ordinal), do: messages

  def join(messages, store, info, ordinal) do
    extras =
      store
      |> Store.messages(info, index: ordinal)
      |> Enum.take(length(messages))
      |> Map.new(&{&1.originating_time, &1.data})

    for message <- messages do
      case Map.get(extras, message.originating_time) do
        %{} = extra -> %{message | data: {:with_extra, message.data, extra}}
        _ -> message
      end
    end
  end

  @doc "Splits data into the value and its extra fields."
  @spec split(term()) :: {term(), map()}
  def split({:with_extra, value, extra}), do: {value, extra}
  def split(value), do: {value, %{}}
end
