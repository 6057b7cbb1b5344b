defmodule Situ.Infer.Http.DecoderTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Infer.Http.Decoder

  defp feed(parts) do
    Enum.reduce_while(parts, {[], Decoder.new()}, fn part, {events, decoder} ->
      case Decoder.push(decoder, part) do
        {:ok, more, decoder} -> {:cont, {events ++ more, decoder}}
        {:error, why} -> {:halt, {:error, why}}
      end
    end)
  end

  # Data may arrive in other pieces, but all of it and the rest must be the same.
  defp result({:error, _}), do: :error

  defp result({events, decoder}) do
    data = for {:data, bytes} <- events, into: "", do: bytes
    {Enum.reject(events, &match?({:data, _}, &1)), data, Decoder.close(decoder)}
  end

  defp cut(bytes, places) do
    places = places |> Enum.map(&rem(&1, byte_size(bytes) + 1)) |> Enum.sort()
    ends = places ++ [byte_size(bytes)]
    for {a, b} <- Enum.zip([0 | places], ends), do: binary_part(bytes, a, b - a)
  end

  defp response(:length, body),
    do: "HTTP/1.1 200 OK\r\nX-A: b\r\nContent-Length: #{byte_size(body)}\r\n\r\n" <> body

  defp response(:close, body), do: "HTTP/1.0 500 Oh\r\nx-a:  b \r\n\r\n" <> body

  defp response(:chunked, body) do
    chunks =
      for <<part::binary-size(3) <- body>>,
        into: "",
        do: "3;x=1\r\n" <> part <> "\r\n"

    rest = binary_part(body, div(byte_size(body), 3) * 3, rem(byte_size(body), 3))
    rest = if rest == "", do: "", else: "#{byte_size(rest)}\r\n#{rest}\r\n"

    "HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" <>
      chunks <> rest <> "0\r\nTrailer: 1\r\n\r\n"
  end

  property "the result does not depend on how the bytes are cut" do
    forall {kind, body, places} <-
             {one_of(Enum.map([:length, :close, :chunked], &constant/1)), binary(),
              list(non_neg_integer())} do
      bytes = response(kind, body)
      whole = result(feed([bytes]))
      {_, data, closed} = whole
      data == body and closed == :ok and result(feed(cut(bytes, places))) == whole
    end
  end

  property "a truncated response is incomplete" do
    forall {kind, n} <- {one_of(Enum.map([:length, :chunked], &constant/1)), non_neg_integer()} do
      bytes = response(kind, "some words")
      part = binary_part(bytes, 0, rem(n, byte_size(bytes)))
      {_, decoder} = feed([part])
      Decoder.close(decoder) == {:error, :cut_off}
    end
  end

  property "any bytes are a response, an error or incomplete" do
    forall bytes <- binary() do
      result(feed([bytes])) != :raised and
        result(feed(["HTTP/1.1 200 OK\r\n" <> bytes])) != :raised
    end
  end

  test "rejects endless parts, and header names create no atoms" do
    assert {:error, _} = feed(List.duplicate(String.duplicate("x", 10_000), 10))
    line = "X-Some: " <> String.duplicate("y", 1_000) <> "\r\n"
    assert {:error, _} = feed(["HTTP/1.1 200 OK\r\n" | List.duplicate(line, 100)])
    chunked = "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    assert {:error, _} = feed([chunked | List.duplicate("1111", 2_000)])
    assert {:error, _} = feed([chunked, "zz\r\n"])
    assert {:error, _} = feed(["HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n"])
    assert {:error, _} = feed(["HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n"])
    assert {:error, _} = feed(["SSH-2.0-OpenSSH\r\n"])
    feed(["HTTP/1.1 200 OK\r\nX-Warm-Up: 1\r\n\r\n"])
    atoms = :erlang.system_info(:atom_count)

    for i <- 1..2_000,
        do: feed(["HTTP/1.1 200 OK\r\nX-Name-#{i}: 1\r\nContent-Length: 0\r\n\r\n"])

    assert :erlang.system_info(:atom_count) - atoms < 1_000
  end
end
