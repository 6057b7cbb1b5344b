defmodule Situ.Studio.FrameSchemaTest do
  use ExUnit.Case, async: true
  alias Situ.Studio.{Frame, FrameSchema, Scene}

  # The page's test (assets/test/data/wire.test.mjs) decodes the same bytes.
  @golden Path.expand("../../golden/reply.hex", __DIR__)

  test "a reply with every kind of frame has the agreed bytes" do
    golden = @golden |> File.read!() |> String.replace("\n", "") |> Base.decode16!(case: :lower)
    assert IO.iodata_to_binary(Frame.encode_reply(every_frame(), reply())) == golden
  end

  test "headers decode to the fields they were encoded from" do
    fields = %{kind: 4, flags: 130, channel: 9, bytes: 3, count: 2, time: -1, step: 1}

    assert FrameSchema.decode(:frame, FrameSchema.encode(:frame, fields) <> "rest") ==
             {fields, "rest"}

    assert FrameSchema.decode(:frame, "short") == :error
  end

  test "flags are numbers of one bit" do
    assert FrameSchema.encode_flags(:reply_flag, live: true, gone: false, replaced: true) == 5
    assert FrameSchema.decode_flags(:reply_flag, 5) == %{live: 1, gone: 0, replaced: 1}
  end

  test "times of lines are exact, although one line is empty" do
    time = 1_700_000_000_000_000_001
    lines = [{"empty", []}, {"full", [{time, 1.0, 1.0, 1.0, 1}, {time + 1, 1.0, 1.0, 1.0, 1}]}]
    bytes = IO.iodata_to_binary(Frame.lines(1, lines, true))

    {%{time: base}, payload} = FrameSchema.decode(:frame, bytes)

    {%{bytes: 5, count: 0}, <<_name::binary-size(8), payload::binary>>} =
      FrameSchema.decode(:line, payload)

    {%{bytes: 4, count: 2}, <<_name::binary-size(8), payload::binary>>} =
      FrameSchema.decode(:line, payload)

    <<first::little-float-64, second::little-float-64, _::binary>> = payload
    assert [base + trunc(first), base + trunc(second)] == [time, time + 1]
  end

  defp reply do
    %{
      request: 7,
      from: -1_000,
      to: 9_000_000_000_000_000_000,
      time: 5_000,
      version: 3,
      live: true
    }
    |> Map.put(:replaced, true)
  end

  defp every_frame do
    point = Scene.new_item(:points, 1, position: Scene.encode_floats([1.0, 2.0, 3.0]))
    rows = [{1_000, 3_000, "runs", "text", ""}, {3_000, nil, "rests", "text", "left"}]
    lines = [{"left", [{1_000, 1.0, 1.0, 1.0, 1}]}, {"right", [{2_000, 0.5, 0.5, 0.5, 1}]}]

    [
      Frame.series(1, [{1_000, 1.0, 2.0, 1.5, 3}, {2_000, nil, nil, nil, 0}], false, sampled: true),
      Frame.segments(2, rows, 3_500),
      Frame.marks(3, [{1_000, 20}, {1_010, 30}], true),
      Frame.image(4, 1_000, {:gray16, 2, 1, <<1, 0, 2, 0>>, 1_000}),
      Frame.json(5, 1_000, %{"speed" => 1.5}),
      Frame.no_message(6),
      Frame.same_message(7),
      Frame.error(8, "no such stream"),
      Frame.pcm(9, 1_000, 48_000, Scene.encode_floats([0.5, -0.5]), 2),
      Frame.lines(10, lines, true, more: 4),
      Frame.scene(11, 1_000, [point], ["a problem"]),
      Frame.audio_chunks(
        12,
        [{1_000, Scene.encode_floats([0.25])}, {2_000, Scene.encode_floats([-0.25])}],
        16_000
      )
    ]
  end
end
