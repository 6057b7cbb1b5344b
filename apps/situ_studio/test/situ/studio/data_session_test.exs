defmodule Situ.Studio.DataSessionTest do
  # Sends a page's requests and checks the replies, message by message.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  import Situ.Studio.Asking
  alias Situ.Studio.{DataSession, History, StreamOverview, Recordings}

  @head 40
  @frame 32

  setup do: {:ok, session: session()}

  test "the first reply contains the time range", %{session: session} do
    {reply, _} = ask(session, %{"req" => 9})
    assert %{req: 9, from: 1_000_000_000, to: 1_999_000_000, frames: [], flags: 0} = reply
  end

  test "sends an image once while it is current", %{session: session} do
    open = %{"open" => [[3, %{"stream" => "image", "viz" => "image"}]], "instant" => [3]}
    {first, session} = ask(session, Map.put(open, "at", "1250000000"))
    assert [%{kind: 4, base: 1_200_000_000, payload: payload}] = first.frames

    assert <<4::little-32, 2::little-32, 6::little-32, 0::32, 2, 0, 0, _::binary>> = payload

    {again, session} = ask(session, %{"instant" => [3], "at" => "1299000000"})
    assert [%{kind: 7}] = again.frames
    {before, _} = ask(session, %{"instant" => [3], "at" => "5"})
    assert [%{kind: 6}] = before.frames
  end

  test "sends depth unchanged, with its unit in micrometers", %{session: session} do
    %{state: history} = session.source
    data = <<500::little-16, 0::16, 65_535::little-16>>
    depth = Situ.DepthImage.new!(width: 3, height: 1, data: data, scale: 0.001)
    History.put(history, "depth", message(1_000_000_000, depth, 0), 8)
    open = [[1, %{"stream" => "depth", "viz" => "depth"}]]
    {%{frames: [frame]}, _} = ask(session, %{"open" => open, "instant" => [1]})

    assert <<3::little-32, 1::little-32, 5::little-32, 1_000::little-32, ^data::binary-6>> =
             frame.payload
  end

  test "moves a snapped cursor to the nearest message", %{session: session} do
    {reply, _} = ask(session, %{"at" => "1260000000", "snap" => "image"})
    assert reply.time == 1_300_000_000
    {reply, _} = ask(session, %{"at" => "1260000000", "snap" => "nothing"})
    assert reply.time == 1_260_000_000
  end

  test "reports invalid requests on their channel, and serves the others", %{
    session: session
  } do
    {reply, _} =
      ask(session, %{
        "open" => [
          [1, %{"stream" => "level", "viz" => "dance"}],
          [2, %{"stream" => "level", "viz" => "line", "path" => "..."}],
          [3, %{"stream" => "level", "viz" => "line"}],
          [4, %{"stream" => "gone", "viz" => "line"}]
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

  test "reports a source that is gone, and keeps its time range", %{session: session} do
    {_, session} = ask(session, %{})
    %{state: history} = session.source
    :ets.delete(history.streams)
    :ets.delete(history.messages)

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "image", "viz" => "image"}]],
        "instant" => [1]
      })

    assert reply.flags == 2
    assert reply.from == 1_000_000_000
    assert [%{kind: 8}] = reply.frames
  end

  test "shows malformed messages as they are", %{session: session} do
    %{state: history} = session.source

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
      open = [[1, %{"stream" => name, "viz" => draw}]]

      {reply, _} = ask(session, %{"open" => open, "instant" => [1], "at" => "1600000000"})
      assert [%{kind: kind}] = reply.frames
      assert kind in [4, 5, 8], "#{inspect(data)} as #{draw}"
    end

    for i <- 0..(length(broken) - 1), draw <- ~w(line lines segments spans marks latency) do
      assert %{kind: kind} = shown(session, "broken#{i}", draw, 1_000_000_000, 2_000_000_000)
      assert kind in [1, 2, 3, 8, 10], "#{inspect(Enum.at(broken, i))} as #{draw}"
    end

    assert {:ok, _} = StreamOverview.list_streams(session.source)
  end

  property "replies to any bytes, or refuses them" do
    forall bytes <- binary() do
      case DataSession.handle_request(
             bytes,
             DataSession.new(Recordings.History.wrap(History.new()))
           ) do
        {:ok, _, _} -> true
        {:error, %Situ.Error{code: :bad_request}} -> true
      end
    end
  end

  property "replies to any JSON, or refuses it" do
    forall fields <- list({key(), value()}) do
      history = History.new()
      History.put(history, "s", message(5, 1.0, 1), 8)
      request = Map.merge(%{"req" => 1}, Map.new(fields))
      text = Situ.JSON.encode(request)

      assert {:ok, _, _} =
               DataSession.handle_request(text, DataSession.new(Recordings.History.wrap(history)))
    end
  end

  defp key, do: one_of(~w(open close series instant at live snap))
  defp value, do: one_of([scalar(), list(list(one_of([scalar(), list(scalar()), spec()])))])
  defp scalar, do: one_of([integer(), boolean(), nil, "1", float(), "s", "line"])
  defp spec, do: one_of([constant(%{"stream" => "s", "viz" => "line"}), constant(%{})])

  test "the sizes are as documented", %{session: session} do
    {:ok, reply, _} = DataSession.handle_request(~s({"req": 1}), session)
    assert IO.iodata_length(reply) == @head
    assert IO.iodata_length(Situ.Studio.Frame.no_message(1)) == @frame
  end
end
