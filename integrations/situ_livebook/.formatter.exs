[inputs: ["{mix,.formatter}.exs", "{lib,test,notebooks}/**/*.{ex,exs}"]]
