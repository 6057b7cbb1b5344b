defmodule Situ.Python.WindowTest do
  use ExUnit.Case, async: true
  alias Situ.Python.Window
  doctest Window

  test "is full at its limit, and takes messages again when half of it is free" do
    window = Window.count_sent(Window.new(), 4)
    assert window.full?
    window = Window.count_done(window)
    assert window.full?
    refute Window.count_done(window).full?
  end

  test "approaches the messages that take 5 ms" do
    adapt = fn window -> Window.adapt(window, 10, 100_000) end
    assert Enum.at(Stream.iterate(Window.new(), adapt), 20).limit == 500
    assert Window.adapt(%Window{limit: 500}, 1, 6_000_000).limit == 1
    assert Enum.at(Stream.iterate(Window.new(), &Window.adapt(&1, 10, 0)), 30).limit == 1_000
  end
end
