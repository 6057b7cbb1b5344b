defmodule Situ.StateMachineTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  doctest Situ.StateMachine

  defmodule Turns do
    # Detects speech: emits `:began` at the first sound and `:ended` after a period of silence.
    @behaviour Situ.StateMachine

    @impl true
    def init(opts), do: {:silent, opts[:patience]}

    @impl true
    def handle_event(:silent, {:message, %{data: true}}, patience),
      do: {:next_state, :speaking, patience, [{:emit, :began}, {:state_timeout, patience}]}

    def handle_event(:speaking, {:message, %{data: true}}, patience),
      do: {:keep_state, patience, [{:state_timeout, patience}]}

    def handle_event(:speaking, :state_timeout, patience),
      do: {:next_state, :silent, patience, [{:emit, :ended}]}

    def handle_event(:speaking, {:closed, _time}, patience),
      do: {:next_state, :silent, patience, [{:emit, :cut_off}]}

    def handle_event(_state, _event, patience), do: {:keep_state, patience}
  end

  defp run(voice),
    do: Situ.Test.run([voice: voice], &Situ.state_machine(&1.voice, Turns, opts: [patience: 10]))

  test "a callback module handles states, timeouts in stream time, and the end" do
    voice = [{0, false}, {5, true}, {12, true}, {30, false}, {40, true}, {45, true}]
    assert run(voice) == {:ok, [{5, :began}, {22, :ended}, {40, :began}, {46, :cut_off}]}
  end

  test "a timeout due at the end fires before it" do
    assert run([{0, true}, {10, false}]) == {:ok, [{0, :began}, {10, :ended}]}
  end

  # A slow reference: a turn is a maximal run of sounds at most 10 ns apart.
  property "turns are runs of sounds without a gap longer than the patience" do
    forall voice <- timed_values(boolean(), 12) do
      sounds = for {time, true} <- voice, do: time

      runs =
        Enum.chunk_while(
          sounds,
          [],
          fn
            time, [last | _] = run when time - last > 10 -> {:cont, Enum.reverse(run), [time]}
            time, run -> {:cont, [time | run]}
          end,
          &{:cont, Enum.reverse(&1), []}
        )

      wanted = for [first | _] <- runs, do: {first, :began}
      {:ok, outputs} = run(voice)
      assert for({time, :began} <- outputs, do: {time, :began}) == wanted
      assert outputs == Enum.sort(outputs)
    end
  end

  @tag :capture_log
  test "an invalid return value is an error that shows it" do
    assert {:error, error} =
             Situ.Test.run([a: [{0, 1}]], fn s ->
               Situ.state_machine(s.a, fn _, _, _ -> :what end, init: {:on, nil})
             end)

    assert Exception.message(error) =~ ":what"

    assert_raise ArgumentError, ~r/init:/, fn ->
      Situ.Graph.build(fn p ->
        p |> Situ.return(1) |> Situ.state_machine(fn _, _, d -> {:keep_state, d} end)
      end)
    end
  end
end
