defmodule Situ.Link.Nats.Protocol do
  @moduledoc false
  # Encodes and parses the NATS client protocol. Pure. A line has at most 4 KiB, a message at most
  # the agreed size.
  import Situ.BinarySize, only: [pinned_size: 1]

  @max_line 4_096

  @type message :: %{
          subject: String.t(),
          reply: String.t() | nil,
          status: String.t() | nil,
          headers: %{String.t() => String.t()},
          data: binary()
        }
  @type frame ::
          :ping
          | :pong
          | :ok
          | {:info, String.t()}
          | {:failure, String.t()}
          | {:message, message()}

  @doc """
  Encodes a message with headers (a list of names and values). Replies go to the subject `reply`.

      iex> alias Situ.Link.Nats.Protocol
      iex> "a.b" |> Protocol.encode_publish("_INBOX.1", [{"K", "v"}], "data") |> IO.iodata_to_binary()
      "HPUB a.b _INBOX.1 18 22\\r\\nNATS/1.0\\r\\nK: v\\r\\n\\r\\ndata\\r\\n"
      iex> Protocol.parse_frame("MSG a.b 1 4\\r\\ndata\\r\\nPI", 1_024)
      {:ok, {:message, %{subject: "a.b", reply: nil, status: nil, headers: %{}, data: "data"}}, "PI"}
      iex> Protocol.parse_frame("PI", 1_024)
      :more
      iex> Protocol.parse_frame("MSG a.b 1 4000\\r\\n", 1_024)
      {:error, "a message of 4000 bytes exceeds the limit of 1024"}
  """
  @spec encode_publish(String.t(), String.t(), [{String.t(), String.t()}], iodata()) :: iodata()
  def encode_publish(subject, reply, headers, data) do
    head = ["NATS/1.0\r\n", for({key, value} <- headers, do: [key, ": ", value, "\r\n"]), "\r\n"]
    size = :erlang.iolist_size(head)
    total = size + :erlang.iolist_size(data)
    ["HPUB ", subject, " ", reply, " #{size} #{total}\r\n", head, data, "\r\n"]
  end

  @doc "Parses the next frame in `bytes`. A message larger than `max` bytes is an error."
  @spec parse_frame(binary(), pos_integer()) ::
          {:ok, frame(), binary()} | :more | {:error, String.t()}
  def parse_frame(bytes, max) do
    case :binary.match(bytes, "\r\n", scope: {0, min(byte_size(bytes), @max_line)}) do
      {at, 2} ->
        <<line::binary-pinned_size(at), "\r\n", rest::binary>> = bytes
        parse_line(line, rest, max)

      :nomatch when byte_size(bytes) >= @max_line ->
        {:error, "a line of more than #{@max_line} bytes"}

      :nomatch ->
        :more
    end
  end

  defp parse_line("PING", rest, _max), do: {:ok, :ping, rest}
  defp parse_line("PONG", rest, _max), do: {:ok, :pong, rest}
  defp parse_line("+OK", rest, _max), do: {:ok, :ok, rest}
  defp parse_line("INFO " <> json, rest, _max), do: {:ok, {:info, json}, rest}
  defp parse_line("-ERR" <> text, rest, _max), do: {:ok, {:failure, trim_text(text)}, rest}

  defp parse_line("MSG " <> line, rest, max) do
    case String.split(line, " ", trim: true) do
      [subject, _sid, size] -> parse_message(subject, nil, "0", size, rest, max)
      [subject, _sid, reply, size] -> parse_message(subject, reply, "0", size, rest, max)
      _ -> {:error, "MSG #{inspect(line)}"}
    end
  end

  defp parse_line("HMSG " <> line, rest, max) do
    case String.split(line, " ", trim: true) do
      [subject, _sid, head, size] -> parse_message(subject, nil, head, size, rest, max)
      [subject, _sid, reply, head, size] -> parse_message(subject, reply, head, size, rest, max)
      _ -> {:error, "HMSG #{inspect(line)}"}
    end
  end

  defp parse_line(line, _rest, _max),
    do: {:error, "unknown frame: #{inspect(line, printable_limit: 40)}"}

  defp trim_text(text), do: text |> String.trim() |> String.trim("'")

  defp parse_message(subject, reply, head, size, rest, max) do
    with {head, ""} when head >= 0 <- Integer.parse(head),
         {size, ""} when size >= head <- Integer.parse(size) do
      cond do
        size > max ->
          {:error, "a message of #{size} bytes exceeds the limit of #{max}"}

        byte_size(rest) < size + 2 ->
          :more

        true ->
          take_payload(subject, reply, head, size - head, rest)
      end
    else
      _ -> {:error, "invalid sizes: #{inspect({head, size})}"}
    end
  end

  defp take_payload(subject, reply, head, size, bytes) do
    case bytes do
      <<lines::binary-pinned_size(head), data::binary-pinned_size(size), "\r\n", rest::binary>> ->
        {status, headers} = parse_headers(lines)

        message = %{
          subject: subject,
          reply: reply,
          status: status,
          headers: headers,
          data: :binary.copy(data)
        }

        {:ok, {:message, message}, rest}

      _ ->
        {:error, "a message does not end with a line break"}
    end
  end

  # "NATS/1.0", or with a status: "NATS/1.0 404 Message Not Found".
  defp parse_headers(""), do: {nil, %{}}

  defp parse_headers(head) do
    [first | lines] = String.split(head, "\r\n")

    headers =
      for line <- lines, [key, value] <- [String.split(line, ":", parts: 2)], into: %{} do
        {key, String.trim(value)}
      end

    status = first |> String.split(" ", trim: true) |> Enum.at(1)
    {status, headers}
  end
end
