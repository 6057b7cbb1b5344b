defmodule Situ.CLI.Commands do
  @moduledoc false
  # The table of commands, in the order `situ --help` shows them.

  @commands [Situ.CLI.Store, Situ.CLI.Studio, Situ.CLI.Devices]

  @spec all() :: [module()]
  def all, do: @commands

  @spec fetch(String.t()) :: {:ok, module()} | {:error, Situ.Error.t()}
  def fetch(name) do
    case Enum.find(all(), &(&1.name() == name)) do
      nil -> {:error, unknown(name)}
      command -> {:ok, command}
    end
  end

  defp unknown(name) do
    fix =
      case Situ.Options.nearest(name, Enum.map(all(), & &1.name())) do
        nil -> "`situ --help` lists the commands"
        near -> "did you mean `situ #{near}`? `situ --help` lists the commands"
      end

    Situ.Error.new(:unknown_command, "there is no command #{inspect(name)}", fix: fix)
  end
end
