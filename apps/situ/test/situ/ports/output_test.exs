defmodule Situ.Ports.OutputTest do
  use ExUnit.Case, async: true

  alias Situ.Delivery
  alias Situ.Ports.{Counters, Output, PostingRules, Subscriber}

  setup do
    counters = Counters.new()
    sub = Subscriber.new(1, self(), counters, Delivery.unlimited())
    {:ok, output: Output.subscribe(Output.new(:out, "A", 1), sub), counters: counters}
  end

  defp post(output, times) do
    {:ok, output} = PostingRules.emit_lists(output, {times, times}, 0, false, nil)
    Output.flush(output, 0)
  end

  defp ask(output, pid, n) do
    {:ok, output} = Output.add_demand(output, {pid, 1}, n)
    output
  end

  defp received do
    receive do
      {:"$gen_consumer", {_, 1}, {:cancel, {:shutdown, {:closed, time}}}} ->
        [{:closed, time} | received()]

      {:"$gen_consumer", {_, 1}, batches} ->
        Enum.flat_map(batches, &Situ.Delivery.Batch.data/1) ++ received()
    after
      0 -> []
    end
  end

  describe "a consumer that is replaced after the closing mark" do
    setup %{counters: counters} do
      dead = spawn(fn -> :ok end)
      sub = Subscriber.new(1, dead, counters, Delivery.unlimited())
      output = Output.subscribe(Output.new(:out, "A", 1), sub)
      output = output |> ask(dead, 10) |> post([1, 2, 3]) |> Output.close(3) |> Output.flush(0)
      assert Output.drained?(output)
      {:ok, output: output}
    end

    defp replace_consumer(output),
      do: Output.map_tagged(output, 1, &Subscriber.replace_consumer(&1, self()))

    test "gets it again, after what was not handled", %{output: output, counters: counters} do
      Counters.count_processed(counters, 1, 0, 0)
      assert Output.drained?(replace_consumer(output))
      assert received() == [2, 3, {:closed, 3}]
    end

    test "gets only the mark if everything was handled", %{output: output, counters: counters} do
      Counters.count_processed(counters, 3, 0, 0)
      assert Output.drained?(replace_consumer(output))
      assert received() == [{:closed, 3}]
    end
  end

  describe "a process that replaces a dead one" do
    setup %{output: output} do
      {:ok, marks: Output.new_marks(1), output: output}
    end

    test "continues after what was sent", %{output: output, marks: marks} do
      output |> Output.attach_marks(marks, 0) |> ask(self(), 2) |> post([1, 2])
      assert Output.attach_marks(Output.new(:out, "A", 1), marks, 0).last_time == 2
    end

    test "posts again what was waiting, also if an earlier one has died without posting",
         %{output: output, marks: marks} do
      output |> Output.attach_marks(marks, 0) |> ask(self(), 2) |> post([1, 2, 3])
      assert Output.attach_marks(Output.new(:out, "A", 1), marks, 0).last_time == nil

      sub = Subscriber.new(1, self(), Counters.new(), Delivery.unlimited())
      idle = Output.subscribe(Output.new(:out, "A", 1), sub)
      idle |> Output.attach_marks(marks, 0) |> Output.flush(0)
      assert Output.attach_marks(Output.new(:out, "A", 1), marks, 0).last_time == nil
    end

    test "posts again what has not passed through the next step of its stage", %{marks: marks} do
      sub = Subscriber.new_local({:step, 1}, self(), Counters.new())
      output = Output.new(:out, "A", 1) |> Output.subscribe(sub) |> Output.attach_marks(marks, 0)

      {[_taken], _output} = output |> post([1, 2]) |> Output.take_local()
      assert Output.attach_marks(Output.new(:out, "A", 1), marks, 0).last_time == nil

      {[_taken], output} = output |> post([1, 2]) |> Output.take_local()
      Output.record_progress(output)
      assert Output.attach_marks(Output.new(:out, "A", 1), marks, 0).last_time == 2
    end
  end
end
