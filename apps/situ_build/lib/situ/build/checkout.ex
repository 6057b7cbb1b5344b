defmodule Situ.Build.Checkout do
  @moduledoc false
  # Lists the files of a git checkout.

  @doc "Returns the paths, relative to `root`, of the files that git tracks or would track, and that still exist."
  @spec list_files(Path.t()) :: [Path.t()]
  def list_files(root) do
    # A new file must pass the checks before it is committed, too.
    arguments = ["ls-files", "--cached", "--others", "--exclude-standard"]
    {files, 0} = System.cmd("git", arguments, cd: root)

    for file <- String.split(files, "\n", trim: true),
        File.regular?(Path.join(root, file)),
        do: file
  end
end
