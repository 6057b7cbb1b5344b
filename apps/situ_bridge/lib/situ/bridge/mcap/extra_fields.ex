defmodule Situ.Bridge.Mcap.ExtraFields do
  @moduledoc false
  # Handles the fields of messages that Situ's types cannot hold, such as headers, covariances and additional point
  # fields. An import writes them to a second stream, and the schema to the metadata of the first one. An export
  # restores both.
  alias Situ.{Message, Store, Time}
  alias Situ.Store.StreamInfo

  @suffix ".extra"
  # The numbers of these streams start above the numbers of channels and connections.
  @first_number 0x1_0000_0000

  @typedoc "The name of a type, the language of its definition, and the definition."
  @type schema :: {name :: String.t(), language :: String.t(), definition :: binary()}

  @doc "Returns the name of the second stream."
  @spec stream_name(String.t()) :: String.t()
  def stream_name(name), do: name <> @suffix

  @doc "Returns the number of the second stream."
  @spec stream_number(non_neg_integer()) :: non_neg_integer()
  def stream_number(id), do: id + @first_number

  @doc "Returns the metadata that an import stores with a stream: the original writer's pairs, and the schema."
  @spec build_metadata([{String.t(), String.t()}], schema() | nil) :: {String.t(), binary()} | nil
  def build_metadata([], nil), do: nil

  def build_metadata(pairs, schema),
    do: {"map", pairs |> Map.new() |> put_schema(schema) |> :erlang.term_to_binary()}

  defp put_schema(metadata, nil), do: metadata

  defp put_schema(metadata, {name, language, definition}) do
    schema = %{"name" => name, "encoding" => language, "definition" => definition}
    Map.put(metadata, "schema", schema)
  end

  @doc "Returns the header of a message, and the fields that are missing or different in `rewritten`."
  @spec take_extra(map(), map()) :: map()
  def take_extra(message, rewritten) do
    extra = missing_fields(message, rewritten)
    if header = message["header"], do: Map.put(extra, "header", header), else: extra
  end

  defp missing_fields(message, rewritten) do
    for {key, value} <- message, rest = diff_value(value, Map.get(rewritten, key)), into: %{} do
      {:rest, rest} = rest
      {key, rest}
    end
  end

  defp diff_value(value, value), do: nil

  defp diff_value(%{} = value, %{} = other)
       when not is_struct(value) and not is_struct(other) do
    rest = missing_fields(value, other)
    if rest == %{}, do: nil, else: {:rest, rest}
  end

  defp diff_value(value, _other), do: {:rest, value}

  @doc "Puts the extra fields into a message."
  @spec put_fields(term(), map()) :: term()
  def put_fields(message, extra) when extra == %{} or not is_map(message), do: message

  def put_fields(message, extra) do
    Map.merge(message, extra, fn
      _key, %{} = value, %{} = override when not is_struct(value) and not is_struct(override) ->
        put_fields(value, override)

      _key, _value, override ->
        override
    end)
  end

  @doc """
  Returns the streams of extra fields by the names of the streams they belong to. The value is `:empty` for an imported
  stream that has no extra fields.
  """
  @spec find_streams([StreamInfo.t()]) :: %{String.t() => StreamInfo.t() | :empty}
  def find_streams(infos) do
    by_name = Map.new(infos, &{&1.name, &1})

    for info <- infos, extra = find_extra(info, by_name[stream_name(info.name)]), into: %{} do
      {info.name, extra}
    end
  end

  defp find_extra(%{count: count}, %{count: count} = extra), do: extra

  defp find_extra(info, _none) do
    if match?({:ok, %{"schema" => _}}, StreamInfo.metadata(info)), do: :empty
  end

  @doc """
  Joins messages from `ordinal` on with their extra fields: the data become `{:with_extra, data, extra}`. Messages of a
  stream that was not imported are returned unchanged.
  """
  @spec join_extra([Message.t()], Store.t(), StreamInfo.t() | :empty | nil, non_neg_integer()) ::
          [Message.t()]
  def join_extra(messages, _store, nil, _ordinal), do: messages

  def join_extra(messages, _store, :empty, _ordinal),
    do: for(message <- messages, do: %{message | data: {:with_extra, message.data, %{}}})

  def join_extra(messages, store, info, ordinal) do
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

  @doc """
  Adds the times of a message that Situ's two timestamps cannot hold: the time of sending, and the time of recording if
  the originating time is later, since Situ does not allow a message to be created before it originates.
  """
  @spec put_times(map(), Time.t(), {recorded :: Time.t(), sent :: Time.t()}) :: map()
  def put_times(extra, time, {recorded, sent}) do
    extra = if sent == recorded, do: extra, else: Map.put(extra, "publish_time", sent)
    if recorded >= time, do: extra, else: Map.put(extra, "record_time", recorded)
  end

  @doc "Returns when a message was recorded and sent. An import keeps both separate from the stamp of the header."
  @spec fetch_times(Message.t()) :: {recorded :: Time.t(), sent :: Time.t()}
  def fetch_times(%{data: {:with_extra, _value, extra}, creation_time: created}) do
    recorded = fetch_time(extra, "record_time", created)
    {recorded, fetch_time(extra, "publish_time", recorded)}
  end

  def fetch_times(%{originating_time: time}), do: {time, time}

  defp fetch_time(extra, key, default) do
    case extra do
      %{^key => time} when is_integer(time) -> time
      _ -> default
    end
  end

  @doc "Splits data into the value and its extra fields."
  @spec split_data(term()) :: {term(), map()}
  def split_data({:with_extra, value, extra}), do: {value, extra}
  def split_data(value), do: {value, %{}}
end
