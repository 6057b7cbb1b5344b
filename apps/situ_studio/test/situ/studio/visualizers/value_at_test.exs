defmodule Situ.Studio.Visualizers.ValueAtTest do
  # The cursor shows the value of the latest message, whatever window is drawn.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  import Situ.Studio.Asking
  alias Situ.{AudioBuffer, AudioFormat}

  @t0 1_000_000_000

  defp told(session, spec, at, more \\ %{}) do
    request = %{"open" => [[9, spec]], "instant" => [9], "at" => Integer.to_string(at)}
    {%{frames: frames}, session} = ask(session, Map.merge(request, more))
    {List.last(frames), session}
  end

  defp values(%{kind: 5, payload: json} = frame) do
    {:ok, %{"time" => time, "values" => values}} = Situ.JSON.decode(json)
    assert frame.base == String.to_integer(time)
    {frame.base, values}
  end

  defp values(%{kind: 6}), do: :none

  property "a line has the exact value of the latest message" do
    forall {rows, at} <- {list({integer(1, 1_000_000), number()}), integer(0, 1_100_000)} do
      rows = rows |> Enum.sort_by(&elem(&1, 0)) |> Enum.dedup_by(&elem(&1, 0))
      session = session()
      put(session, "numbers", [{2_000_000, 0} | rows])
      {frame, _} = told(session, %{"stream" => "numbers", "viz" => "line"}, at)

      case Enum.take_while(rows, fn {t, _} -> t <= at end) |> List.last() do
        nil ->
          assert values(frame) == :none

        {t, nil} ->
          assert values(frame) == {t, []}

        {t, x} ->
          assert {^t, [["", text]]} = values(frame)
          assert read(text) === x
      end
    end
  end

  defp number, do: one_of([float(), integer(), integer(-(2 ** 70), 2 ** 70), constant(nil)])

  defp read(text) do
    case Integer.parse(text) do
      {n, ""} -> n
      _ -> String.to_float(text)
    end
  end

  test "is the same in a narrow and a wide window, and is sent once while it holds" do
    session = session()
    spec = %{"stream" => "level", "viz" => "line"}
    at = @t0 + 123_400_000

    window =
      &%{"series" => [[9, Integer.to_string(@t0), Integer.to_string(@t0 + &1), div(&1, 500)]]}

    {narrow, _} = told(session, spec, at, window.(10_000_000))
    {wide, session} = told(session, spec, at, window.(900_000_000))
    assert values(narrow) == {@t0 + 123_000_000, [["", "123.0"]]}
    assert values(wide) == values(narrow)
    {%{frames: [again]}, _} = ask(session, %{"instant" => [9], "at" => "#{at + 1}"})
    assert again.kind == 7
  end

  test "returns the value of each key of a map, of a path, or the latency" do
    session = session()
    put(session, "map", [{@t0, %{"a" => 0.1, b: 2}}, {@t0 + 10, %{"a" => :nan}}])
    maps = %{"stream" => "map", "viz" => "lines"}
    {frame, _} = told(session, maps, @t0 + 5)
    assert {@t0, values} = values(frame)
    assert Enum.sort(values) == [["a", "0.1"], ["b", "2"]]
    path = %{"stream" => "map", "viz" => "line", "path" => "[\"a\"]"}
    {frame, _} = told(session, path, @t0 + 5)
    assert values(frame) == {@t0, [["", "0.1"]]}
    {frame, _} = told(session, path, @t0 + 10)
    assert values(frame) == {@t0 + 10, [["", "nan"]]}
    {frame, _} = told(session, %{"stream" => "level", "viz" => "latency"}, @t0)
    assert {@t0, [["", latency]]} = values(frame)
    assert String.to_float(latency) >= 0
  end

  test "returns the current audio sample of the channel that is drawn" do
    session = session()
    format = AudioFormat.pcm(1_000, 2)
    data = for i <- 0..499, into: <<>>, do: <<i * 8::little-16, -i::little-signed-16>>

    buffers =
      for i <- 1..3//2, do: {@t0 + i * 500_000_000, %AudioBuffer{format: format, data: data}}

    put(session, "mic", buffers)
    spec = %{"stream" => "mic", "viz" => "waveform", "props" => %{"channel" => "2"}}

    for {ms, sample} <- [{0, 0}, {0.5, 0}, {1, 1}, {499, 499}, {499.999, 499}, {1_200, 200}] do
      {frame, _} = told(session, spec, @t0 + round(ms * 1_000_000))
      assert {_, [["", text]]} = values(frame)
      assert String.to_float(text) == -sample / 32_768, "at #{ms} ms"
    end

    # In the gap, it is the last sample before it, with its time.
    {frame, _} = told(session, spec, @t0 + 800_000_000)
    assert {@t0 + 499_000_000, [["", Float.to_string(-499 / 32_768)]]} == values(frame)
    {frame, _} = told(session, %{spec | "props" => %{}}, @t0 + 2_000_000)
    assert {_, [["1", left], ["2", right]]} = values(frame)
    assert {String.to_float(left), String.to_float(right)} == {16 / 32_768, -2 / 32_768}
    assert {%{kind: 6}, _} = told(session, spec, @t0 - 1)
  end
end
