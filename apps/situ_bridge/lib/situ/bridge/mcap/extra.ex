defmodule Situ.Bridge.Mcap.Extra do
  @moduledoc false
  # Fields of messages that Situ's types have no place for: headers, covariances, further fields of points. An import
  # keeps them in a stream of their own, and an export puts them back.
  alias Situ.{Message, Store}
  alias Situ.Store.StreamInfo

  @ending ".extra"
  # Streams of extras have numbers above those of channels and connections.
  @number 0x1_0000_0000

  @doc "The name of the second stream."
  @spec name(String.t()) :: String.t()
  def name(name), do: name <> @ending

  @doc "The number of the second stream."
  @spec number(non_neg_integer()) :: non_neg_integer()
  def number(id), do: id + @number

  @doc "Returns the fields of a message that another one does not have, and its header."
  @spec of(map(), map()) :: map()
  def of(message, again) do
    extra = without(message, again)
    if header = message["header"], do: Map.put(extra, "header", header), else: extra
  end

  defp without(message, again) do
    for {key, value} <- message, rest = differing(value, Map.get(again, key)), into: %{} do
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

  @doc "A message with its extra fields."
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

  @doc "Streams by the name of the stream whose extras they are."
  @spec streams([StreamInfo.t()]) :: %{String.t() => StreamInfo.t()}
  def streams(infos) do
    by_name = Map.new(infos, &{&1.name, &1})

    for %{name: base, count: count} <- infos,
        %{count: ^count} = extra <- [by_name[name(base)]],
        into: %{},
        do: {base, extra}
  end

  @doc "Messages from `ordinal` on, each with its extra fields as `{:with_extra, data, extra}`."
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

  @doc "The value and the extra fields of data."
  @spec split(term()) :: {term(), map()}
  def split({:with_extra, value, extra}), do: {value, extra}
  def split(value), do: {value, %{}}
end
