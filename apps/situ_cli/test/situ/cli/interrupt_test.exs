defmodule Situ.CLI.InterruptTest do
  # The VM has one handler of signals.
  use ExUnit.Case
  alias Situ.CLI.Interrupt

  defp handlers, do: :erl_signal_server |> :gen_event.which_handlers() |> Enum.sort()

  test "sends one message for any number of signals, and restores Erlang's handler" do
    before = handlers()

    Interrupt.with_message(:stop, fn ->
      for _ <- 1..2, do: {_, 0} = System.cmd("kill", ["-TERM", System.pid()])
      assert_receive :stop
      refute_receive :stop, 100
    end)

    assert handlers() == before
    assert catch_throw(Interrupt.with_message(:stop, fn -> throw(:oops) end)) == :oops
    assert handlers() == before
  end
end
