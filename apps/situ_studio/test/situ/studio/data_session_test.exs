defmodule Situ.Studio.DataSessionTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Studio.{DataSession, History, Source}

  @head 40
  @frame 32

  setup do
    history = History.new(live: false)

    for i <- 0..999 do
      t = 1_000_000_000 + i * 1_000_000
      History.put(history, "level", message(t, i * 1.0, i), 8)
      History.put(history, "on", message(t, rem(div(i, 100), 2) == 0, i), 8)
    end

    for i <- 0..9 do
      image = Situ.Image.filled(4, 2, :rgb24, [i, 0, 0])
      History.put(history, "image", message(1_000_000_000 + i * 100_000_000, image, i), 24)
    end

    %{session: DataSession.new({Source.History, history})}
  end

  defp message(time, data, n),
    do: %Situ.Message{
      data: data,
      originating_time: time,
      creation_time: time + 5_000_000,
      sequence_id: n
    }

  defp ask(session, request) do
    text = request |> Map.put_new("req", 1) |> Situ.JSON.encode()
    {:ok, reply, session} = DataSession.handle(text, session)
    {parse(IO.iodata_to_binary(reply)), session}
  end

  # The same reading as the page's, written again from the table in Situ.Studio.Frame.
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

  defp column(%{payload: payload, rows: n}, i) do
    column = binary_part(payload, i * 8 * n, 8 * n)
    for <<x::little-float-64 <- column>>, do: x
  end

  test "the first answer tells the extents", %{session: session} do
    {reply, _} = ask(session, %{"req" => 9})
    assert %{req: 9, from: 1_000_000_000, to: 1_999_000_000, frames: [], flags: 0} = reply
  end

  test "a wide window is summed up and keeps the extremes", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "draw" => "line"}]],
        "series" => [[1, "1000000000", "1999000000", 100_000_000]]
      })

    assert [%{kind: 1, channel: 1, flags: 0} = frame] = reply.frames
    assert frame.rows in 9..12
    assert Enum.min(column(frame, 1)) == 0.0
    assert Enum.max(column(frame, 2)) == 999.0
    assert Enum.sum(column(frame, 4)) == 1000.0
  end

  test "a narrow window has single messages, with the neighbours outside of it", %{
    session: session
  } do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "draw" => "line"}]],
        "series" => [[1, "1500000000", "1502000000", 1_000]]
      })

    assert [%{kind: 1, flags: 1} = frame] = reply.frames
    assert column(frame, 3) == [499.0, 500.0, 501.0, 502.0, 503.0]
  end

  test "states are merged, the one in force at the left edge included", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "on", "draw" => "segments"}]],
        "series" => [[1, "1150000000", "1350000000", 100_000]]
      })

    assert [%{kind: 2, payload: json}] = reply.frames

    assert Situ.JSON.decode(json) ==
             {:ok,
              [
                [0, 51_000_000, "false", "false"],
                [51_000_000, 151_000_000, "true", "true"],
                [151_000_000, 202_000_000, "false", "false"]
              ]}
  end

  defp shown(session, stream, draw, from, to) do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => stream, "draw" => draw}]],
        "series" => [[1, Integer.to_string(from), Integer.to_string(to), div(to - from, 1_000)]]
      })

    [frame] = reply.frames
    frame
  end

  defp json(text) do
    {:ok, value} = Situ.JSON.decode(text)
    value
  end

  defp put(session, stream, rows) do
    {_, history} = session.source

    for {{t, data}, i} <- Enum.with_index(rows),
        do: History.put(history, stream, message(t, data, i), 8)
  end

  test "maps of states are lanes with names; a key that is gone ends its lane", %{
    session: session
  } do
    put(session, "talk", [
      {1_100_000_000, %{0 => false}},
      {1_200_000_000, %{0 => true, 1 => false}},
      {1_300_000_000, %{1 => false}},
      {1_400_000_000, %{1 => true}}
    ])

    # the newest message within the window is told too
    assert %{kind: 2, base: base, own: 300_000_000, payload: json} =
             shown(session, "talk", "segments", 1_150_000_000, 1_500_000_000)

    rows = for [a, b | rest] <- json(json), do: [base + a, b && base + b | rest]

    assert rows == [
             [1_100_000_000, 1_200_000_000, "false", "false", "0"],
             [1_200_000_000, 1_300_000_000, "true", "true", "0"],
             [1_200_000_000, 1_400_000_000, "false", "false", "1"],
             [1_400_000_000, nil, "true", "true", "1"]
           ]
  end

  test "intervals are drawn over their span, also when they began before the window or are told of after it",
       %{session: session} do
    put(session, "speech", [
      {1_200_000_000, %{start: 1_100_000_000, stop: 1_200_000_000, text: "before"}},
      {1_500_000_000, %{start: 1_300_000_000, stop: 1_500_000_000, text: "begins before"}},
      {1_900_000_000, %{start: 1_600_000_000, stop: 1_900_000_000, text: "told after"}},
      {1_950_000_000, %{start: 1_940_000_000, stop: 1_950_000_000, text: "after"}}
    ])

    assert %{kind: 2, base: 1_300_000_000, payload: json} =
             shown(session, "speech", "spans", 1_400_000_000, 1_700_000_000)

    assert [
             [0, 200_000_000, "begins before", "span"],
             [300_000_000, 600_000_000, "told after", "span"]
           ] = json(json)
  end

  test "maps of numbers are lines with names and gaps", %{session: session} do
    put(session, "opening", [
      {1_100_000_000, %{"left" => 1.0}},
      {1_200_000_000, %{"left" => 2.0, "right" => 5.0}},
      {1_300_000_000, %{"right" => nil}}
    ])

    assert %{kind: 10, rows: 2, flags: 1, base: 1_100_000_000, payload: payload} =
             shown(session, "opening", "lines", 1_000_000_000, 1_500_000_000)

    nan = <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>

    assert <<4::little-32, 3::little-32, "left", 0::32, left::binary-size(120), rest::binary>> =
             payload

    assert <<5::little-32, 2::little-32, "right", 0::24, right::binary-size(80)>> = rest

    assert <<+0.0::little-float-64, 1.0e8::little-float-64, 2.0e8::little-float-64, _::binary>> =
             left

    assert <<1.0::little-float-64, 2.0::little-float-64, ^nan::binary-8>> =
             binary_part(left, 72, 24)

    assert <<5.0::little-float-64, ^nan::binary-8>> = binary_part(right, 48, 16)
  end

  test "an hour of states is bounded by what can be told apart", %{session: session} do
    put(
      session,
      "flicker",
      for(i <- 0..19_999, do: {1_000_000_000 + i * 40_000_000, rem(i, 2) == 0})
    )

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "flicker", "draw" => "segments"}]],
        "series" => [[1, "0", "900000000000", 1_000_000_000]]
      })

    assert [%{kind: 2, payload: json}] = reply.frames
    rows = json(json)
    assert length(rows) < 10
    assert Enum.any?(rows, &match?([_, _, "", "many"], &1))
  end

  test "more messages than can be read at once are a sample of the whole window", %{
    session: session
  } do
    put(session, "long", for(i <- 0..250_000, do: {1_000_000_000 + i * 400_000, i > 125_000}))

    assert %{kind: 2, payload: json} = shown(session, "long", "segments", 0, 102_000_000_000)

    assert [[0, half, "false", "false"], [half, nil, "true", "true"]] = json(json)

    assert_in_delta half, 50_000_000_000, 150_000_000
  end

  test "a picture is sent once while it holds", %{session: session} do
    open = %{"open" => [[3, %{"stream" => "image", "draw" => "image"}]], "instant" => [3]}
    {first, session} = ask(session, Map.put(open, "at", "1250000000"))
    assert [%{kind: 4, base: 1_200_000_000, payload: payload}] = first.frames

    assert <<4::little-32, 2::little-32, 6::little-32, 0::32, 2, 0, 0, _::binary>> = payload

    {again, session} = ask(session, %{"instant" => [3], "at" => "1299000000"})
    assert [%{kind: 7}] = again.frames
    {before, _} = ask(session, %{"instant" => [3], "at" => "5"})
    assert [%{kind: 6}] = before.frames
  end

  test "depth goes as it is, with its unit in micrometres", %{session: session} do
    {_, history} = session.source
    data = <<500::little-16, 0::16, 65_535::little-16>>
    depth = Situ.DepthImage.new!(width: 3, height: 1, data: data, scale: 0.001)
    History.put(history, "depth", message(1_000_000_000, depth, 0), 8)
    open = [[1, %{"stream" => "depth", "draw" => "depth"}]]
    {%{frames: [frame]}, _} = ask(session, %{"open" => open, "instant" => [1]})

    assert <<3::little-32, 1::little-32, 5::little-32, 1_000::little-32, ^data::binary-6>> =
             frame.payload
  end

  test "a snapped cursor is moved to the nearest message", %{session: session} do
    {reply, _} = ask(session, %{"at" => "1260000000", "snap" => "image"})
    assert reply.time == 1_300_000_000
    {reply, _} = ask(session, %{"at" => "1260000000", "snap" => "nothing"})
    assert reply.time == 1_260_000_000
  end

  test "what is asked for wrongly is said on its channel, and the others are answered", %{
    session: session
  } do
    {reply, _} =
      ask(session, %{
        "open" => [
          [1, %{"stream" => "level", "draw" => "dance"}],
          [2, %{"stream" => "level", "draw" => "line", "path" => "..."}],
          [3, %{"stream" => "level", "draw" => "line"}],
          [4, %{"stream" => "gone", "draw" => "line"}]
        ],
        "series" => [
          [1, "0", "2000000000", 1_000_000],
          [2, "0", "2000000000", 1_000_000],
          [3, "0", "2000000000", 1],
          [3, "0", "2000000000", 100_000_000],
          [4, "0", "2000000000", 100_000_000]
        ]
      })

    assert [8, 8, 8, 1, 1] = Enum.map(reply.frames, & &1.kind)
  end

  test "a source that is gone says so and keeps its extents", %{session: session} do
    {_, session} = ask(session, %{})
    {_, history} = session.source
    :ets.delete(history.streams)
    :ets.delete(history.messages)

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "image", "draw" => "image"}]],
        "instant" => [1]
      })

    assert reply.flags == 2
    assert reply.from == 1_000_000_000
    assert [%{kind: 8}] = reply.frames
  end

  test "messages that are not what they claim to be are shown as such", %{session: session} do
    {_, history} = session.source

    broken = [
      %{__struct__: Situ.Rect, x: 1},
      %{__struct__: Situ.Rect, x: "a", y: nil, width: 1, height: 1, label: 7, id: {}, score: :x},
      %{__struct__: Situ.Image, width: 4, height: 4, format: :rgb24, stride: 12, data: "short"},
      %{__struct__: Situ.Image, width: -4},
      %{__struct__: Situ.EncodedImage, format: :tiff},
      %{__struct__: NoSuchModule, a: 1},
      [1 | 2],
      {<<1::3>>, self(), fn -> 1 end},
      %{start: 5, stop: "x"},
      %{"a" => [%{start: 1, stop: 0}, :b]},
      [%{start: 1, stop: 2} | :tail],
      %{{1, 2} => 3.0, <<255>> => nil, 5 => true}
    ]

    for {data, i} <- Enum.with_index(broken), draw <- ~w(image shapes value bars text) do
      name = "broken#{i}"
      History.put(history, name, message(1_500_000_000, data, 0), 8)
      open = [[1, %{"stream" => name, "draw" => draw}]]

      {reply, _} = ask(session, %{"open" => open, "instant" => [1], "at" => "1600000000"})
      assert [%{kind: kind}] = reply.frames
      assert kind in [4, 5, 8], "#{inspect(data)} as #{draw}"
    end

    for i <- 0..(length(broken) - 1), draw <- ~w(line lines segments spans marks latency) do
      assert %{kind: kind} = shown(session, "broken#{i}", draw, 1_000_000_000, 2_000_000_000)
      assert kind in [1, 2, 3, 8, 10], "#{inspect(Enum.at(broken, i))} as #{draw}"
    end

    assert {:ok, _} = Source.call(session.source, :streams, [])
  end

  property "whatever bytes come, there is an answer or a refusal" do
    forall bytes <- binary() do
      case DataSession.handle(bytes, DataSession.new({Source.History, History.new()})) do
        {:ok, _, _} -> true
        {:error, %Situ.Error{code: :bad_request}} -> true
      end
    end
  end

  property "whatever JSON comes, there is an answer or a refusal" do
    forall fields <- list({key(), value()}) do
      history = History.new()
      History.put(history, "s", message(5, 1.0, 1), 8)
      request = Map.merge(%{"req" => 1}, Map.new(fields))
      text = Situ.JSON.encode(request)
      assert {:ok, _, _} = DataSession.handle(text, DataSession.new({Source.History, history}))
    end
  end

  defp key, do: one_of(~w(open close series instant at live snap))
  defp value, do: one_of([scalar(), list(list(one_of([scalar(), list(scalar()), spec()])))])
  defp scalar, do: one_of([integer(), boolean(), nil, "1", float(), "s", "line"])
  defp spec, do: one_of([constant(%{"stream" => "s", "draw" => "line"}), constant(%{})])

  test "sizes are as documented", %{session: session} do
    {:ok, reply, _} = DataSession.handle(~s({"req": 1}), session)
    assert IO.iodata_length(reply) == @head
    assert IO.iodata_length(Situ.Studio.Frame.none(1)) == @frame
  end
end
