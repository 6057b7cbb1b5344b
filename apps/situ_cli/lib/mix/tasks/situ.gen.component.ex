defmodule Mix.Tasks.Situ.Gen.Component do
  @shortdoc "Adds a component of Situ and its test to the project"
  @moduledoc """
  Adds a component and its test to the project in the current folder, as `situ new --component NAME` does.

      $ mix situ.gen.component blink-detector
        lib/lobby/blink_detector.ex
        test/lobby/blink_detector_test.exs
      Use it: Situ.via(stream, Lobby.BlinkDetector). Test it: mix test

  No existing file is overwritten. The guide "Writing a component" explains the parts.
  """
  use Mix.Task

  @impl Mix.Task
  def run([name]) when binary_part(name, 0, 1) != "-" do
    Situ.CLI.New.add_part(:component, name)
    :ok
  rescue
    error in Situ.Error -> Mix.raise(Exception.message(error))
  end

  def run(_arguments),
    do: Mix.raise("give the name of the component, as in: mix situ.gen.component blink-detector")
end
