defmodule Situ.Python.Package do
  @moduledoc false
  # The Python package `situ` for workers. It is copied into the `priv` folder of this app when this module is compiled,
  # so that releases and applications that depend on Situ contain it.
  @source Path.expand("../../../../../clients/python/src/situ", __DIR__)
  @target Path.expand("../../../priv/python/situ", __DIR__)

  @files Path.wildcard(Path.join(@source, "*.{py,typed}"))
  for file <- @files, do: @external_resource(file)

  File.rm_rf!(@target)
  File.mkdir_p!(@target)
  for file <- @files, do: File.cp!(file, Path.join(@target, Path.basename(file)))

  @doc "Returns the folder that contains the package, for `PYTHONPATH`."
  @spec folder() :: Path.t()
  def folder, do: Path.join(:code.priv_dir(:situ_python), "python")
end
