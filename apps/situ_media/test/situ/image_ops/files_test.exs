defmodule Situ.ImageOps.FilesTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Files
end
