defmodule Situ.Studio.GuidePlugin do
  @moduledoc false
  # Writes the plug-in of docs/guides/your-own-visualizer.md to a folder.

  @guide Path.expand("../../../../docs/guides/your-own-visualizer.md", __DIR__)
  @file_block ~r/^`([a-z.\/_]+)`:\n\n```\w+\n(.*?)```/ms

  def write(folder) do
    for [path, text] <- Regex.scan(@file_block, File.read!(@guide), capture: :all_but_first) do
      path = Path.join(folder, path)
      File.mkdir_p!(Path.dirname(path))
      File.write!(path, text)
      path
    end
  end
end
