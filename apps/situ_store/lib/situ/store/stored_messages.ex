defmodule Situ.Store.StoredMessages do
  @moduledoc false
  # Builds messages from the results of the native reader, `{codec, part}` for each chunk.
  alias Situ.Message
  alias Situ.Store.{Codecs, StreamInfo, TermCodec, Undecoded}

  @typedoc "The rows of a chunk of integers, or `{sequence, originating, creation, data}` for each message."
  @type part :: {:integers, binary()} | [tuple()]

  @doc "Returns the messages of all parts in order."
  @spec build_messages([{non_neg_integer(), part()}], StreamInfo.t()) :: [Message.t()]
  def build_messages(runs, info) do
    # From the last part to the first, so that no list is copied.
    runs
    |> Enum.reverse()
    |> Enum.reduce([], fn {codec, part}, later -> build_part(part, codec, info, later) end)
  end

  defp build_part({:integers, rows}, 0, info, later),
    do: build_integers(rows, info.id, Message, later)

  defp build_part(list, 0, info, later), do: build_terms(list, info.id, Message, later)

  defp build_part(list, number, info, later) do
    {name, module_name} = Map.get(info.codecs, number, {nil, nil})
    module = name && Codecs.find_module(name, module_name)
    decoded = Enum.map(list, &put_elem(&1, 3, Codecs.decode_payload(module, name, elem(&1, 3))))
    build_terms(decoded, info.id, Message, later)
  end

  # These functions take the name of the struct as an argument. With `%Message{}` or a constant name, the compiler
  # extends a map of one key, which takes twice as long and gives every message a copy of the keys (8 of 22 words).
  defp build_integers(
         <<sequence::64, time::signed-64, creation::signed-64, data::signed-64, rest::binary>>,
         id,
         struct,
         later
       ) do
    message = %{
      __struct__: struct,
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: sequence,
      source_id: id
    }

    [message | build_integers(rest, id, struct, later)]
  end

  defp build_integers(<<>>, _id, _struct, later), do: later

  defp build_terms([{sequence, time, creation, data} | rest], id, struct, later) do
    message = %{
      __struct__: struct,
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: sequence,
      source_id: id
    }

    [message | build_terms(rest, id, struct, later)]
  end

  # Tuples of five elements contain data that could not be decoded as a plain term.
  defp build_terms([{sequence, time, creation, kind, details} | rest], id, struct, later) do
    data = resolve_data(kind, details)
    build_terms([{sequence, time, creation, data} | rest], id, struct, later)
  end

  defp build_terms([], _id, _struct, later), do: later

  defp resolve_data(:undecodable, reason), do: %Undecoded{reason: reason}

  defp resolve_data(:unknown, {modules, bytes, term}),
    do: TermCodec.resolve_structs(modules, bytes, term)
end
