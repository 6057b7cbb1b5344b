defmodule Situ.Studio.Asking do
  @moduledoc false
  # A conversation with a data session about a small history. It reads the replies like the page.
  alias Situ.Studio.{DataSession, History, Recordings}

  def session do
    history = History.new(live: false)

    for i <- 0..999 do
      t = 1_000_000_000 + i * 1_000_000
      History.put(history, "level", message(t, i * 1.0, i), 8)
      History.put(history, "on", message(t, rem(div(i, 100), 2) == 0, i), 8)
    end

    for i <- 0..9 do
      image = Situ.Image.new_filled(4, 2, :rgb24, [i, 0, 0])
      History.put(history, "image", message(1_000_000_000 + i * 100_000_000, image, i), 24)
    end

    DataSession.new(Recordings.History.wrap(history))
  end

  # Returns a source with one stream of rows {time, data}.
  def source(stream, rows) do
    history = History.new(live: false, seconds: 1_000_000)

    for {{t, data}, i} <- Enum.with_index(rows),
        do: History.put(history, stream, message(t, data, i), 8)

    Recordings.History.wrap(history)
  end

  def message(time, data, n),
    do: %Situ.Message{
      data: data,
      originating_time: time,
      creation_time: time + 5_000_000,
      sequence_id: n
    }

  def ask(session, request) do
    text = request |> Map.put_new("req", 1) |> Situ.JSON.encode()
    {:ok, reply, session} = DataSession.handle_request(text, session)
    {parse(IO.iodata_to_binary(reply)), session}
  end

  # Reads like the page, but is written separately from the table in Situ.Studio.Frame.
  defp parse(
         <<1, 0, flags::little-16, req::little-32, from::little-signed-64, to::little-signed-64,
           n::little-32, version::little-32, time::little-signed-64, rest::binary>>
       ) do
    {frames, ""} = Enum.map_reduce(List.duplicate(nil, n), rest, fn _, rest -> frame(rest) end)
    %{flags: flags, req: req, from: from, to: to, version: version, time: time, frames: frames}
  end

  defp frame(
         <<kind::little-16, flags::little-16, channel::little-32, size::little-32,
           rows::little-32, base::little-signed-64, own::little-signed-64,
           payload::binary-size(size), rest::binary>>
       ) do
    pad = rem(8 - rem(size, 8), 8)
    <<0::size(pad * 8), rest::binary>> = rest

    {%{
       kind: kind,
       flags: flags,
       channel: channel,
       rows: rows,
       base: base,
       own: own,
       payload: payload
     }, rest}
  end

  def json(text) do
    {:ok, value} = Situ.JSON.decode(text)
    value
  end

  def put(session, stream, rows) do
    %{state: history} = session.source

    for {{t, data}, i} <- Enum.with_index(rows),
        do: History.put(history, stream, message(t, data, i), 8)
  end

  def column(%{payload: payload, rows: n}, i) do
    column = binary_part(payload, i * 8 * n, 8 * n)
    for <<x::little-float-64 <- column>>, do: x
  end

  def shown(session, stream, viz, from, to) do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => stream, "viz" => viz}]],
        "series" => [[1, Integer.to_string(from), Integer.to_string(to), div(to - from, 1_000)]]
      })

    [frame] = reply.frames
    frame
  end
end
