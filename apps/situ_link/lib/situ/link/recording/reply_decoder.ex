defmodule Situ.Link.Recording.ReplyDecoder do
  @moduledoc false
  # Decodes reply bodies without trusting them: terms go through the checked decoder of stores, and the form of every
  # reply is validated. Pure.
  alias Situ.Message
  alias Situ.Link.Wire.Batch
  alias Situ.Store.{StreamInfo, TermCodec, TypeName}

  @type result(form) :: {:ok, form} | :error

  @fields %StreamInfo{id: 0, name: ""} |> Map.from_struct() |> Map.keys() |> List.delete(:extra)
  @numbers [:id, :count, :size, :stored, :latency_sum]
  @times [:opened, :closed, :first, :last, :first_creation, :last_creation]

  @spec decode_info(binary()) :: result(map())
  def decode_info(body) do
    with {:ok, %{name: name, live?: live?, closed?: closed?} = info} <- decode_term(body),
         true <- is_binary(name) and is_boolean(live?) and is_boolean(closed?),
         true <- info[:version] == nil or is_integer(info[:version]) do
      {:ok, Map.put(info, :damage, List.wrap(info[:damage]))}
    else
      _ -> :error
    end
  end

  @spec decode_streams(binary(), String.t()) :: result([StreamInfo.t()])
  def decode_streams(body, address) do
    with {:ok, list} when is_list(list) <- decode_term(body),
         true <- Enum.all?(list, &valid_stream?/1) do
      {:ok, for(map <- list, do: build_stream_info(map, address))}
    else
      _ -> :error
    end
  end

  defp valid_stream?(%{name: name, type_name: type} = map) do
    is_binary(name) and is_binary(type) and Enum.all?(@numbers, &is_number(map[&1])) and
      Enum.all?(@times, &(map[&1] == nil or is_integer(map[&1]))) and is_map(map[:codecs]) and
      match?(s when s == nil or tuple_size(s) == 2, map[:supplemental])
  end

  defp valid_stream?(_other), do: false

  defp build_stream_info(map, address) do
    info = struct!(StreamInfo, Map.take(map, @fields))
    type = with {:ok, type} <- TypeName.parse_type(info.type_name), do: type, else: (_ -> :any)
    %{info | type: type, store_path: address}
  end

  @spec decode_number(binary()) :: result(non_neg_integer())
  def decode_number(body) do
    with {:ok, n} when is_integer(n) and n >= 0 <- decode_term(body),
         do: {:ok, n},
         else: (_ -> :error)
  end

  @spec decode_summary(binary()) :: result({pos_integer(), [tuple()]})
  def decode_summary(body) do
    with {:ok, {width, bins}} when is_integer(width) and width > 0 and is_list(bins) <-
           decode_term(body),
         true <-
           Enum.all?(bins, &match?({s, _, _, _, n} when is_integer(s) and is_integer(n), &1)) do
      {:ok, {width, bins}}
    else
      _ -> :error
    end
  end

  @spec decode_tracks(binary()) :: result({[tuple()], [tuple()]})
  def decode_tracks(body) do
    with {:ok, {counts, tracks}} when is_list(counts) and is_list(tracks) <- decode_term(body),
         true <- Enum.all?(counts, &match?({s, n} when is_integer(s) and is_integer(n), &1)),
         true <-
           Enum.all?(
             tracks,
             &match?({_key, {kind, list}} when is_atom(kind) and is_list(list), &1)
           ) do
      {:ok, {counts, tracks}}
    else
      _ -> :error
    end
  end

  @spec decode_spans(binary()) :: result([{Situ.Time.t(), Situ.Time.t()}])
  def decode_spans(body),
    do: decode_list(body, &match?({a, b} when is_integer(a) and is_integer(b), &1))

  @spec decode_strings(binary()) :: result([String.t()])
  def decode_strings(body), do: decode_list(body, &is_binary/1)

  defp decode_list(body, valid?) do
    with {:ok, list} when is_list(list) <- decode_term(body), true <- Enum.all?(list, valid?) do
      {:ok, list}
    else
      _ -> :error
    end
  end

  @spec decode_notice(binary()) :: result({:published | :ended, non_neg_integer()})
  def decode_notice(body) do
    with {:ok, {kind, n}} when kind in [:published, :ended] and is_integer(n) <- decode_term(body) do
      {:ok, {kind, n}}
    else
      _ -> :error
    end
  end

  @spec decode_messages(binary(), integer()) :: result({[Message.t()], non_neg_integer()})
  def decode_messages(<<next::64, batches::binary>>, id) do
    with {:ok, messages} <- decode_batches(batches, []) do
      {:ok, {for(%Message{} = message <- messages, do: %{message | source_id: id}), next}}
    end
  end

  def decode_messages(_body, _id), do: :error

  defp decode_batches(<<>>, lists), do: {:ok, lists |> Enum.reverse() |> Enum.concat()}

  defp decode_batches(<<size::32, payload::binary-size(size), rest::binary>>, lists) do
    case Batch.decode(payload) do
      {:ok, messages} -> decode_batches(rest, [messages | lists])
      {:error, _} -> :error
    end
  end

  defp decode_batches(_cut, _lists), do: :error

  defp decode_term(body) do
    with {:error, _} <- TermCodec.decode(body), do: :error
  end
end
