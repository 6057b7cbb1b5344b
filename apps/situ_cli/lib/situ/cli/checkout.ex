defmodule Situ.CLI.Checkout do
  @moduledoc false
  # The folder that contains Situ: a checkout, or an unpacked release.

  @doc "Returns the folder. bin/situ sets SITU_ROOT; otherwise, this application is in _build/ENV/lib of a checkout."
  @spec folder() :: Path.t()
  def folder do
    System.get_env("SITU_ROOT") ||
      :situ_cli |> :code.lib_dir() |> to_string() |> Path.join("../../../..") |> Path.expand()
  end

  @doc "Returns the path of a script, such as `setup`."
  @spec script_path(String.t()) :: Path.t()
  def script_path(name), do: Path.join([folder(), "bin", name])
end
