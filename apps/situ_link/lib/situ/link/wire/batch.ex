defmodule Situ.Link.Wire.Batch do
  @moduledoc false
  # Encodes messages as payloads of `batch` frames, and decodes them. Pure.
  #
  # A payload begins with a length byte `n` and a name of `n` bytes, which selects the encoding:
  #
  #   * `""`: one external term, a list of `{sequence id, originating time, creation time, data}`;
  #   * `":bytes"`, or the name of a `Situ.Codec`: for each message its sequence id (64 bits), originating and creation
  #     time (64 bits each, signed), the length of its data (32 bits), and the data.
  #
  # Decoding does not trust its input. Terms go through the decoder of stores (no new atoms, no
  # functions, bounded memory). Binaries are sub-binaries of the payload, not copies. Data that
  # cannot be decoded become a `Situ.Store.Undecoded` in their message, so that the stream
  # continues.
  alias Situ.Message
  alias Situ.Store.{Codecs, TermCodec}

  @bytes_codec ":bytes"
  # Encoding smaller binaries separately has no advantage over putting them into the term.
  @min_bytes 512
  @max_bytes 256 * 1024

  @typedoc "First and last originating time, count and payload: the fields of a `batch` frame after its channel."
  @type part :: {Situ.Time.t(), Situ.Time.t(), pos_integer(), iodata()}

  @doc "Returns a time that is earlier than those of all messages, but far from the limits of 64-bit integers."
  @spec before_all() :: Situ.Time.t()
  def before_all, do: -0x4000000000000000

  @doc """
  Encodes messages as payloads of at most about 256 KiB, or of a single larger message.

  Does not check the data: messages that contain more than plain data are decoded as `Situ.Store.Undecoded`; see
  `split_encodable/1`.

      iex> alias Situ.Link.Wire.Batch
      iex> message = %Situ.Message{data: {:ok, 1.5}, originating_time: 10, creation_time: 11, sequence_id: 3}
      iex> [{10, 10, 1, payload}] = Batch.encode([message])
      iex> payload |> IO.iodata_to_binary() |> Batch.decode()
      {:ok, [message]}
      iex> Batch.decode(<<9, "cut">>)
      {:error, "a payload cut short"}
  """
  @spec encode([Message.t()]) :: [part()]
  def encode([]), do: []

  def encode(messages) do
    messages
    |> Enum.chunk_by(&payload_codec(&1.data))
    |> Enum.flat_map(fn [first | _] = run -> encode_run(payload_codec(first.data), run) end)
  end

  defp payload_codec(data) when is_binary(data),
    do: if(byte_size(data) >= @min_bytes, do: @bytes_codec)

  defp payload_codec(%_{} = data), do: Codecs.module_for(data)
  defp payload_codec(_data), do: nil

  defp encode_run(nil, messages) do
    tuples =
      for message <- messages,
          do: {message.sequence_id, message.originating_time, message.creation_time, message.data}

    [build_part(messages, length(messages), [<<0>>, :erlang.term_to_iovec(tuples)])]
  end

  defp encode_run(@bytes_codec, messages), do: encode_records(@bytes_codec, messages, & &1)

  defp encode_run(module, messages),
    do: encode_records(module.codec_name(), messages, &module.encode/1)

  defp encode_records(name, messages, encode) do
    head = <<byte_size(name), name::binary>>

    messages
    |> Enum.map(&{&1, encode_record(&1, encode.(&1.data))})
    |> Enum.chunk_while(
      {0, []},
      fn {_, {size, _}} = entry, {total, entries} ->
        if entries != [] and total + size > @max_bytes,
          do: {:cont, Enum.reverse(entries), {size, [entry]}},
          else: {:cont, {total + size, [entry | entries]}}
      end,
      fn {_, entries} -> {:cont, Enum.reverse(entries), nil} end
    )
    |> Enum.map(fn group ->
      {messages, records} = Enum.unzip(group)
      build_part(messages, length(messages), [head | Enum.map(records, &elem(&1, 1))])
    end)
  end

  defp encode_record(message, bytes) do
    size = IO.iodata_length(bytes)

    {size + 28,
     [
       <<message.sequence_id::64, message.originating_time::signed-64,
         message.creation_time::signed-64, size::32>>
       | bytes
     ]}
  end

  defp build_part([first | _] = messages, count, payload),
    do: {first.originating_time, List.last(messages).originating_time, count, payload}

  @doc "Returns the messages that can be sent, and the number of others (they hold functions, processes or the like)."
  @spec split_encodable([Message.t()]) :: {[Message.t()], non_neg_integer()}
  def split_encodable(messages) do
    case TermCodec.encode(for %{data: data} <- messages, do: data) do
      {:ok, _} ->
        {messages, 0}

      {:error, _} ->
        {encodable, rejected} =
          Enum.split_with(messages, &match?({:ok, _}, TermCodec.encode(&1.data)))

        {encodable, length(rejected)}
    end
  end

  @doc "Decodes the messages of a payload. If the payload is unreadable, returns the reason as text."
  @spec decode(binary()) :: {:ok, [Message.t()]} | {:error, String.t()}
  def decode(<<0, bytes::binary>>) do
    with {:ok, list} when is_list(list) <- TermCodec.decode(bytes),
         do: terms_to_messages(list, []),
         else: (_ -> {:error, "the payload is not a list of messages"})
  end

  def decode(<<n, name::binary-size(n), records::binary>>) do
    case find_decoder(name) do
      nil -> {:error, "the codec name is not valid UTF-8"}
      decode -> decode_records(records, decode, [])
    end
  end

  def decode(_bytes), do: {:error, "a payload cut short"}

  defp terms_to_messages([{sequence, time, creation, data} | rest], messages)
       when is_integer(sequence) and sequence >= 0 and is_integer(time) and is_integer(creation) do
    message = %Message{
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: sequence
    }

    terms_to_messages(rest, [message | messages])
  end

  defp terms_to_messages([], messages), do: {:ok, Enum.reverse(messages)}
  defp terms_to_messages(_other, _done), do: {:error, "the payload is not a list of messages"}

  defp find_decoder(@bytes_codec), do: & &1

  defp find_decoder(name) do
    if String.valid?(name) do
      module = Codecs.find_module(name, nil)
      &Codecs.decode_payload(module, name, &1)
    end
  end

  defp decode_records(
         <<sequence::64, time::signed-64, creation::signed-64, size::32, bytes::binary-size(size),
           rest::binary>>,
         decode,
         messages
       ) do
    message = %Message{
      data: decode.(bytes),
      originating_time: time,
      creation_time: creation,
      sequence_id: sequence
    }

    decode_records(rest, decode, [message | messages])
  end

  defp decode_records(<<>>, _decode, messages), do: {:ok, Enum.reverse(messages)}
  defp decode_records(_rest, _decode, _done), do: {:error, "a payload cut short"}
end
