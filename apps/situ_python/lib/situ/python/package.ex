defmodule Situ.Python.Package do
  @moduledoc false
  # The Python package `situ` for workers. It is copied into the `priv` folder of this app when this module is compiled,
  # so that releases and applications that depend on Situ contain it. Builds of different environments share the
  # folder, and workers may be using it at the same time, so a file is replaced as a whole, and only if it differs.
  @source Path.expand("../../../../../clients/python/src/situ", __DIR__)
  @target Path.expand("../../../priv/python/situ", __DIR__)

  @files Path.wildcard(Path.join(@source, "*.{py,typed}"))
  for file <- @files, do: @external_resource(file)
  File.mkdir_p!(@target)

  for file <- @files,
      text = File.read!(file),
      target = Path.join(@target, Path.basename(file)),
      File.read(target) != {:ok, text} do
    new = "#{target}.#{System.pid()}"
    File.write!(new, text)
    File.rename!(new, target)
  end

  for file <- Path.wildcard(Path.join(@target, "*.py")),
      Path.basename(file) not in Enum.map(@files, &Path.basename/1),
      do: File.rm(file)

  @doc "Returns the folder that contains the package, for `PYTHONPATH`."
  @spec folder() :: Path.t()
  def folder, do: Path.join(:code.priv_dir(:situ_python), "python")
end
