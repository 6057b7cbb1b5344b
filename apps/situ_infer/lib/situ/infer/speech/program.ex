defmodule Situ.Infer.Speech.Program do
  @moduledoc false
  # The external programs of recognizers and synthesizers.
  alias Situ.Error

  @doc "Runs a command for at most `seconds`, and returns its output and status."
  @spec run([String.t()], pos_integer()) :: {binary(), non_neg_integer()}
  def run(command, seconds) do
    # The program's error output is discarded because it would go to the terminal.
    limited = ["timeout", "-k", "1", "#{seconds}" | command]
    System.cmd("/bin/sh", ["-c", ~S(exec "$@" 2>/dev/null), "situ-speech" | limited])
  end

  @doc "Returns the path of the program espeak-ng."
  @spec find_espeak() :: {:ok, Path.t()} | {:error, Error.t()}
  def find_espeak do
    case System.find_executable("espeak-ng") do
      nil ->
        {:error,
         Error.new(:no_espeak, "the program espeak-ng is not installed",
           why: "it determines the pronunciation of words",
           fix: "install it: apt-get install espeak-ng"
         )}

      path ->
        {:ok, path}
    end
  end
end
