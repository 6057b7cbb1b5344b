defmodule Situ.Imaging.FilesTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Files
end
