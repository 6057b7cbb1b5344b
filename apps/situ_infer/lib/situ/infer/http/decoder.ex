defmodule Situ.Infer.Http.Decoder do
  @moduledoc false
  # Decodes the bytes of an HTTP/1.1 response (RFC 9112), split at arbitrary positions, into events. The lengths of the
  # head and of a chunk's size line are limited, and no input creates an atom.
  import Situ.Bits, only: [known: 1]

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
    do: step(%{decoder | buffer: decoder.buffer <> bytes}, [])

  @doc "Checks whether the response is complete when the server closes the connection."
  @spec close(t()) :: :ok | {:error, :cut_off}
  def close(%__MODULE__{state: state}) when state in [:until_close, :done], do: :ok
  def close(_decoder), do: {:error, :cut_off}

  defp step(%{state: state, buffer: buffer} = d, events) when state in [:status, :headers] do
    kind = if state == :status, do: :http_bin, else: :httph_bin

    case :erlang.decode_packet(kind, buffer, []) do
      {:more, _} when d.head + byte_size(buffer) > @head_bytes -> too_long()
      {:more, _} -> {:ok, Enum.reverse(events), d}
      {:ok, packet, rest} -> head(packet, taken(d, rest), events)
      {:error, _} -> {:error, "its head is malformed"}
    end
  end

  defp step(%{state: :done} = d, events), do: {:ok, Enum.reverse(events), %{d | buffer: ""}}
  defp step(%{buffer: ""} = d, events), do: {:ok, Enum.reverse(events), d}

  defp step(%{state: :until_close} = d, events),
    do: {:ok, Enum.reverse([{:data, d.buffer} | events]), %{d | buffer: ""}}

  defp step(%{state: {kind, left}} = d, events) when kind in [:length, :chunk] do
    case d.buffer do
      <<data::binary-known(left), rest::binary>> ->
        after_data(kind, %{d | buffer: rest}, data(data, events))

      data ->
        d = %{d | buffer: "", state: {kind, left - byte_size(data)}}
        {:ok, Enum.reverse([{:data, data} | events]), d}
    end
  end

  defp step(%{state: line} = d, events) when line in [:size, :gap, :trailer] do
    case :binary.split(d.buffer, "\n") do
      [text, rest] -> line(line, String.trim_trailing(text, "\r"), %{d | buffer: rest}, events)
      [text] when byte_size(text) > @line_bytes -> {:error, "one of its lines is too long"}
      _ -> {:ok, Enum.reverse(events), d}
    end
  end

  defp taken(d, rest),
    do: %{d | head: d.head + byte_size(d.buffer) - byte_size(rest), buffer: rest}

  defp too_long, do: {:error, "its head is longer than #{@head_bytes} bytes"}

  defp head({:http_response, {1, _}, status, _}, %{state: :status} = d, events),
    do: step(%{d | state: :headers, status: status, headers: []}, events)

  defp head({:http_header, _, name, _, value}, %{state: :headers} = d, events) do
    if d.head > @head_bytes,
      do: too_long(),
      else: step(%{d | headers: [{String.downcase(to_string(name)), value} | d.headers]}, events)
  end

  # A 1xx response precedes the final response.
  defp head(:http_eoh, %{status: status} = d, events) when status in 100..199,
    do: step(%{d | state: :status}, events)

  defp head(:http_eoh, d, events) do
    headers = Enum.reverse(d.headers)

    case body(d.status, headers) do
      {:error, why} ->
        {:error, why}

      :done ->
        step(%{d | state: :done}, [:done, {:status, d.status, headers} | events])

      state ->
        step(%{d | state: state}, [{:status, d.status, headers} | events])
    end
  end

  defp head(_other, _d, _events), do: {:error, "its head is not HTTP"}

  defp body(status, _headers) when status in [204, 304], do: :done

  defp body(_status, headers) do
    coding = headers |> value("transfer-encoding", "") |> String.downcase()
    length = value(headers, "content-length", nil)

    cond do
      coding == "chunked" -> :size
      coding not in ["", "identity"] -> {:error, "its transfer encoding is #{inspect(coding)}"}
      length == nil -> :until_close
      length == "0" -> :done
      length =~ ~r/\A[0-9]{1,15}\z/ -> {:length, String.to_integer(length)}
      true -> {:error, "its length is #{inspect(length, printable_limit: 40)}"}
    end
  end

  defp value(headers, name, default) do
    case List.keyfind(headers, name, 0) do
      {_, value} -> value
      nil -> default
    end
  end

  defp line(:size, text, d, events) do
    case Regex.run(~r/\A([0-9a-fA-F]{1,8})[ \t]*(;.*)?\z/, text) do
      [_, hex | _] -> size(String.to_integer(hex, 16), d, events)
      nil -> {:error, "one of its chunks has no size"}
    end
  end

  defp line(:gap, "", d, events), do: step(%{d | state: :size}, events)
  defp line(:gap, _text, _d, _events), do: {:error, "one of its chunks is longer than announced"}
  defp line(:trailer, "", d, events), do: step(%{d | state: :done}, [:done | events])

  defp line(:trailer, text, d, events) do
    head = d.head + byte_size(text)
    if head > @head_bytes, do: too_long(), else: step(%{d | head: head}, events)
  end

  defp size(0, d, events), do: step(%{d | state: :trailer}, events)
  defp size(n, d, events), do: step(%{d | state: {:chunk, n}}, events)

  defp after_data(:length, d, events), do: step(%{d | state: :done}, [:done | events])
  defp after_data(:chunk, d, events), do: step(%{d | state: :gap}, events)

  defp data("", events), do: events
  defp data(data, events), do: [{:data, data} | events]
end
