defmodule Situ.Infer.Http.Decoder do
  @moduledoc false
  # Decodes the bytes of an HTTP/1.1 response (RFC 9112), split at arbitrary positions, into events. The lengths of the
  # head and of a chunk's size line are limited, and no input creates an atom.
  import Situ.BinarySize, only: [pinned_size: 1]

  @head_bytes 65_536
  @line_bytes 4_096

  defstruct state: :status, buffer: "", head: 0, status: nil, headers: []

  @type t :: %__MODULE__{}
  @type event :: Situ.Infer.Http.event() | :done

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Decodes the bytes and returns the completed events, with `:done` at the end of the response."
  @spec push(t(), binary()) :: {:ok, [event()], t()} | {:error, String.t()}
  def push(%__MODULE__{} = decoder, bytes),
    do: decode_next(%{decoder | buffer: decoder.buffer <> bytes}, [])

  @doc "Checks whether the response is complete when the server closes the connection."
  @spec close(t()) :: :ok | {:error, :cut_off}
  def close(%__MODULE__{state: state}) when state in [:until_close, :done], do: :ok
  def close(_decoder), do: {:error, :cut_off}

  defp decode_next(%{state: state, buffer: buffer} = d, events)
       when state in [:status, :headers] do
    kind = if state == :status, do: :http_bin, else: :httph_bin

    case :erlang.decode_packet(kind, buffer, []) do
      {:more, _} when d.head + byte_size(buffer) > @head_bytes -> too_long()
      {:more, _} -> {:ok, Enum.reverse(events), d}
      {:ok, packet, rest} -> handle_head(packet, consume_head(d, rest), events)
      {:error, _} -> {:error, "its head is malformed"}
    end
  end

  defp decode_next(%{state: :done} = d, events),
    do: {:ok, Enum.reverse(events), %{d | buffer: ""}}

  defp decode_next(%{buffer: ""} = d, events), do: {:ok, Enum.reverse(events), d}

  defp decode_next(%{state: :until_close} = d, events),
    do: {:ok, Enum.reverse([{:data, d.buffer} | events]), %{d | buffer: ""}}

  defp decode_next(%{state: {kind, left}} = d, events) when kind in [:length, :chunk] do
    case d.buffer do
      <<data::binary-pinned_size(left), rest::binary>> ->
        after_data(kind, %{d | buffer: rest}, add_data(data, events))

      data ->
        d = %{d | buffer: "", state: {kind, left - byte_size(data)}}
        {:ok, Enum.reverse([{:data, data} | events]), d}
    end
  end

  defp decode_next(%{state: line} = d, events) when line in [:size, :gap, :trailer] do
    case :binary.split(d.buffer, "\n") do
      [text, rest] ->
        handle_line(line, String.trim_trailing(text, "\r"), %{d | buffer: rest}, events)

      [text] when byte_size(text) > @line_bytes ->
        {:error, "one of its lines is too long"}

      _ ->
        {:ok, Enum.reverse(events), d}
    end
  end

  defp consume_head(d, rest),
    do: %{d | head: d.head + byte_size(d.buffer) - byte_size(rest), buffer: rest}

  defp too_long, do: {:error, "its head is longer than #{@head_bytes} bytes"}

  defp handle_head({:http_response, {1, _}, status, _}, %{state: :status} = d, events),
    do: decode_next(%{d | state: :headers, status: status, headers: []}, events)

  defp handle_head({:http_header, _, name, _, value}, %{state: :headers} = d, events) do
    if d.head > @head_bytes,
      do: too_long(),
      else:
        decode_next(
          %{d | headers: [{String.downcase(to_string(name)), value} | d.headers]},
          events
        )
  end

  # A 1xx response precedes the final response.
  defp handle_head(:http_eoh, %{status: status} = d, events) when status in 100..199,
    do: decode_next(%{d | state: :status}, events)

  defp handle_head(:http_eoh, d, events) do
    headers = Enum.reverse(d.headers)

    case body_state(d.status, headers) do
      {:error, why} ->
        {:error, why}

      :done ->
        decode_next(%{d | state: :done}, [:done, {:status, d.status, headers} | events])

      state ->
        decode_next(%{d | state: state}, [{:status, d.status, headers} | events])
    end
  end

  defp handle_head(_other, _d, _events), do: {:error, "its head is not HTTP"}

  defp body_state(status, _headers) when status in [204, 304], do: :done

  defp body_state(_status, headers) do
    coding = headers |> header_value("transfer-encoding", "") |> String.downcase()
    length = header_value(headers, "content-length", nil)

    cond do
      coding == "chunked" -> :size
      coding not in ["", "identity"] -> {:error, "its transfer encoding is #{inspect(coding)}"}
      length == nil -> :until_close
      length == "0" -> :done
      length =~ ~r/\A[0-9]{1,15}\z/ -> {:length, String.to_integer(length)}
      true -> {:error, "its length is #{inspect(length, printable_limit: 40)}"}
    end
  end

  defp header_value(headers, name, default) do
    case List.keyfind(headers, name, 0) do
      {_, value} -> value
      nil -> default
    end
  end

  defp handle_line(:size, text, d, events) do
    case Regex.run(~r/\A([0-9a-fA-F]{1,8})[ \t]*(;.*)?\z/, text) do
      [_, hex | _] -> start_chunk(String.to_integer(hex, 16), d, events)
      nil -> {:error, "one of its chunks has no size"}
    end
  end

  defp handle_line(:gap, "", d, events), do: decode_next(%{d | state: :size}, events)

  defp handle_line(:gap, _text, _d, _events),
    do: {:error, "one of its chunks is longer than announced"}

  defp handle_line(:trailer, "", d, events),
    do: decode_next(%{d | state: :done}, [:done | events])

  defp handle_line(:trailer, text, d, events) do
    head = d.head + byte_size(text)
    if head > @head_bytes, do: too_long(), else: decode_next(%{d | head: head}, events)
  end

  defp start_chunk(0, d, events), do: decode_next(%{d | state: :trailer}, events)
  defp start_chunk(n, d, events), do: decode_next(%{d | state: {:chunk, n}}, events)

  defp after_data(:length, d, events), do: decode_next(%{d | state: :done}, [:done | events])
  defp after_data(:chunk, d, events), do: decode_next(%{d | state: :gap}, events)

  defp add_data("", events), do: events
  defp add_data(data, events), do: [{:data, data} | events]
end
