defmodule Situ.Build.Checkout do
  @moduledoc false
  # Lists the files of a git checkout.

  @doc "Returns the paths, relative to `root`, of the files that git tracks and that still exist."
  @spec list_files(Path.t()) :: [Path.t()]
  def list_files(root) do
    {files, 0} = System.cmd("git", ["ls-files"], cd: root)

    for file <- String.split(files, "\n", trim: true),
        File.regular?(Path.join(root, file)),
        do: file
  end
end
