defmodule Situ.Live.DiffClientTest do
  # Random states of the demo view are diffed and merged by the stock client's own Rendered class. After each state
  # it must hold exactly the HTML of a complete server rendering.
  use ExUnit.Case, async: true
  alias Situ.Live.{Demo, Diff, Html, NodeTools, ViewLifecycle, Socket}

  @moduletag :node
  @moduletag timeout: 120_000
  @sequences 250
  @length 24

  test "the client rebuilds the server's HTML from #{@sequences * @length} diffs" do
    seed = System.get_env("SITU_SEED", "7") |> String.to_integer()
    :rand.seed(:exsss, {1, 2, seed})
    lines = for _ <- 1..@sequences, line <- sequence(), do: Situ.JSON.encode(line)
    assert replay(lines, "whole") == %{"states" => @sequences * @length, "wrong" => []}
  end

  test "the comparison detects a change that is not sent" do
    :rand.seed(:exsss, {1, 2, 3})

    lines =
      for {line, i} <- Enum.with_index(sequence()) do
        Situ.JSON.encode(if i == 9, do: %{line | "diff" => %{}}, else: line)
      end

    assert %{"wrong" => [%{"state" => 10} | _]} = replay(lines, "spoilt")
  end

  defp replay(lines, name) do
    bundle = NodeTools.bundle!()
    path = Path.join(bundle, name <> ".jsonl")
    File.write!(path, Enum.intersperse(lines, "\n"))
    {output, 0} = NodeTools.run(Path.join(bundle, "rendered.mjs"), [path])
    {:ok, result} = Situ.JSON.decode(String.trim(output))
    result
  end

  # Half of the states are reached by assigning, so that unchanged parts are skipped as in a running view.
  defp sequence do
    socket = Socket.assign(%Socket{id: "phx-1", view: Demo.Main}, state())

    {lines, _} =
      Enum.map_reduce(1..@length, {socket, %Diff{}}, fn i, {socket, memory} ->
        what = if i == 1 or :rand.uniform(8) == 1, do: :all, else: :changed
        {diff, memory} = diff(socket, what, memory)
        html = socket |> ViewLifecycle.render_view(:all) |> Html.to_html()
        line = %{"first" => i == 1, "diff" => diff, "html" => html}
        next = socket |> Socket.__clear_message__() |> Socket.assign(Enum.take_random(state(), 4))
        {line, {next, memory}}
      end)

    lines
  end

  defp diff(socket, what, memory) do
    case Diff.diff_tree(ViewLifecycle.render_view(socket, what), memory) do
      :stale -> Diff.diff_tree(ViewLifecycle.render_view(socket, :all), memory)
      result -> result
    end
  end

  # The stream is left empty: the client forgets its rows, so there is no HTML to compare.
  defp state do
    rows =
      for id <- Enum.take_random(1..12, :rand.uniform(13) - 1) do
        %{id: id, name: "row <#{id}>", v: Enum.random([1, 2, 101, 102])}
      end

    %{
      count: :rand.uniform(4),
      open: Enum.random([true, false]),
      dis: Enum.random([true, false, nil]),
      q: Enum.random(["", "a<b", "é\"'&", "\u2028"]),
      note: Enum.random(["x", "", nil]),
      tick: :rand.uniform(3),
      tab: Enum.random(["a", "b"]),
      nasty: Enum.random(["<", <<255, 254>>, "ok"]),
      user: Enum.random([nil, "ann"]),
      rows: rows,
      streams: %{lines: Situ.Live.Stream.new(:lines, [], [])}
    }
  end
end
