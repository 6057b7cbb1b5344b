defmodule Situ.CLI.Checkout do
  @moduledoc false
  # The folder that contains Situ: a checkout, or an unpacked release.

  @doc "Returns the folder. bin/situ sets SITU_ROOT; otherwise, this application is in _build/ENV/lib of a checkout."
  @spec folder() :: Path.t()
  def folder do
    System.get_env("SITU_ROOT") ||
      :situ_cli |> :code.lib_dir() |> to_string() |> Path.join("../../../..") |> Path.expand()
  end

  @doc """
  Returns PATH without the folders of an unpacked release. Its Erlang adds them for itself, but it cannot run mix, which
  must find the Erlang of the system.
  """
  @spec outer_path() :: String.t()
  def outer_path do
    root = to_string(:code.root_dir())
    path = System.get_env("PATH", "")

    if root == folder() do
      path
      |> String.split(":")
      |> Enum.reject(&String.starts_with?(&1, root <> "/"))
      |> Enum.join(":")
    else
      path
    end
  end

  @doc "Returns the path of a script, such as `setup`."
  @spec script_path(String.t()) :: Path.t()
  def script_path(name), do: Path.join([folder(), "bin", name])
end
